"""Words for time, motion and effort in column headers, in the languages of testing machines."""

import unicodedata
from collections.abc import Mapping
from types import MappingProxyType


def without_accents(text: str) -> str:
    """Return a text without accents: "Déplacement" and "Deplacement" are one word.

    Args:
        text: a word or a name, in any script.
    """
    letters = unicodedata.normalize("NFKD", text)
    return "".join(letter for letter in letters if not unicodedata.combining(letter))


def plain(text: str) -> str:
    """Return a text in lower case without accents, the spelling used in `WORDS`.

    Args:
        text: a word or a name, in any script.
    """
    return without_accents(text).lower()


# English, German, French and Spanish. Words for strain and stress are excluded.
_BY_QUANTITY = {
    "time": """
        t time times timestamp sec seconds clock millis micros zeit prüfzeit testzeit messzeit temps durée
        tiempo
    """,
    "displacement": """
        x z d depth disp displ displacement indentation deformation stroke extension compression travel
        distance crosshead traverse deflection elongation weg standardweg traversenweg hub kolbenweg
        verformung verschiebung eindringtiefe längenänderung déplacement allongement enfoncement course
        desplazamiento extensión alargamiento carrera
    """,
    "force": """
        f fz fn force load loadcell forcez kraft standardkraft prüfkraft normalkraft last charge fuerza carga
    """,
    "torque": """
        iq tau tor trq torque torques effort efforts cur current currents moment drehmoment strom motorstrom
        couple courant corriente momento
    """,
    "position": """
        q ang angle angles theta pos position positions encoder encoders enc winkel posición ángulo
    """,
    "velocity": "v vel dq qd velocity speed omega rpm geschwindigkeit vitesse velocidad",
    "run": "run trial cycle test rep repeat press versuch messung zyklus lauf essai ensayo",
}

WORDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {quantity: frozenset(map(plain, words.split())) for quantity, words in _BY_QUANTITY.items()}
)
"""Words for each quantity, spelled as by `plain`; words of three or more letters may be part of a name."""

CURRENT = frozenset(
    "cur current currents i iq strom motorstrom courant corriente".split()  # noqa: SIM905
)
"""Words for a motor's current, which may represent a torque."""
