"""Words for time, motion and effort in column headers, in the languages of testing machines."""

import unicodedata
from collections.abc import Mapping
from types import MappingProxyType

_ASCII = str.maketrans("łŁøØıß", "lLoOis")


def without_accents(text: str) -> str:
    """Return a text without accents: "Déplacement" and "Deplacement" are one word.

    Args:
        text: a word or a name, in any script.
    """
    letters = unicodedata.normalize("NFKD", text)
    bare = "".join(letter for letter in letters if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", bare).translate(_ASCII)


def plain(text: str) -> str:
    """Return a text in lower case without accents, the spelling used in `WORDS`.

    Args:
        text: a word or a name, in any script.
    """
    return without_accents(text).lower()


# English, German, French, Spanish, Italian and Portuguese, Polish and Czech, Dutch and Swedish, Turkish; last
# line: Russian, Chinese, Japanese, Korean. Words for strain and stress are excluded.
_BY_QUANTITY = {
    "time": """
        t time times timestamp sec seconds clock millis micros zeit prüfzeit testzeit messzeit temps durée
        tiempo tempo czas čas tijd tid zaman süre saat
        время 时间 時間 试验时间 試験時間 시간
    """,
    "displacement": """
        x z d depth disp displ displacement indentation deformation stroke extension compression travel
        distance crosshead traverse deflection elongation weg standardweg traversenweg hub kolbenweg
        verformung verschiebung eindringtiefe längenänderung déplacement allongement enfoncement course
        desplazamiento extensión alargamiento carrera spostamento allungamento corsa deslocamento
        alongamento przemieszczenie wydłużenie ugięcie posuv posunutí prodloužení verplaatsing förskjutning
        uzama deplasman yerdeğiştirme
        перемещение удлинение 位移 变位 变形 伸长 行程 横梁位移 変位 伸び ストローク 변위
    """,
    "force": """
        f fz fn force load loadcell forcez kraft standardkraft prüfkraft normalkraft last charge fuerza
        carga forza carico força siła obciążenie síla kracht kuvvet yük
        сила нагрузка усилие 力 载荷 荷载 负荷 试验力 力值 荷重 試験力 하중
    """,
    "torque": """
        iq tau tor trq qfrc torque torques effort efforts cur current currents moment drehmoment strom
        motorstrom couple courant corriente momento coppia corrente koppel tork
        момент ток 扭矩 转矩 轉矩 电流 トルク 電流
    """,
    "position": """
        q qpos jpos ang angle angles theta pos position positions encoder encoders enc winkel posición ángulo
        posizione angolo posição pozycja kąt konum
        положение угол 位置 角度
    """,
    "velocity": """
        v vel dq qd qvel jvel velocity speed omega rpm geschwindigkeit vitesse velocidad velocità velocidade
        prędkość snelheid hız
        скорость 速度 转速 轉速
    """,
    "run": "run trial cycle test rep repeat press versuch messung zyklus lauf essai ensayo prova",
}

WORDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {quantity: frozenset(map(plain, words.split())) for quantity, words in _BY_QUANTITY.items()}
)
"""Words for each quantity, spelled as by `plain`; words of three or more letters may be part of a name."""

CURRENT = frozenset(
    map(plain, "cur current currents i iq strom motorstrom courant corriente corrente ток 电流 電流".split())  # noqa: SIM905
)
"""Words for a motor's current, which may represent a torque."""

FOREIGN_WORDS = frozenset(
    word for words in _BY_QUANTITY.values() for word in words.split() if not word.isascii() and len(word) > 1
)
"""Words with non-ASCII letters, which reveal the encoding of a text."""
