"""Hidden effects of a world, and effects drawn at random."""

from collections.abc import Sequence
from zlib import crc32

import numpy as np

from robot_io.errors import InputError
from sim_backend.contact_laws import EngineContact
from sim_backend.hooks import HiddenEffects
from sim_backend.imperfection import IMPERFECTIONS, Imperfection
from sim_backend.noise_scale import CONTACT, NoiseScale
from sim_backend.scenario import Scenario

WEAKEST, STRONGEST = 5.0, 50.0  # times the noise floor
_STREAM = crc32(b"hidden")  # apart from the sensors' noise, which comes from the same seed


def hidden_effects(imperfections: Sequence[Imperfection], joint_count: int) -> HiddenEffects:
    """Make the effects of one world, with memories of their own.

    Args:
        imperfections: from the drives to the links, and from the object to the tip.
        joint_count: of the arm.

    Returns:
        The effects.

    Raises:
        InputError: one is in a joint that the arm does not have.
    """
    return sum((entry.effects(joint_count) for entry in imperfections), HiddenEffects())


def noise_scale(scenario: Scenario) -> NoiseScale:
    """Compute noise floors and motion of a probing run.

    Args:
        scenario: the world.

    Returns:
        The scale.
    """
    return NoiseScale.of(scenario.object.law, scenario.sensors)


def draw_hidden(
    seed: int, channel: str | None = None, *, effect: str | None = None, scenario: Scenario | None = None
) -> list[Imperfection]:
    """Draw one effect at random, 5 to 50 times the noise floor of a probing run with the default plan.

    Equal seeds draw the same.

    Args:
        seed: of the draw.
        channel: where it is to show, such as "contact" or "joint_2"; None to draw it (the contact half the
            time).
        effect: name of the effect; None to draw it.
        scenario: the world; None for the default one.

    Returns:
        Entries for the scenario's section `hidden`.

    Raises:
        InputError: no such channel or effect, or no probing run shows the effect in the channel.
    """
    scenario = Scenario() if scenario is None else scenario
    scale, generator = noise_scale(scenario), np.random.default_rng([seed, _STREAM])
    names = list(IMPERFECTIONS) if effect is None else [IMPERFECTIONS[effect].name]
    if isinstance(scenario.object.law, EngineContact):
        names = [name for name in names if not IMPERFECTIONS[name].needs_force_law]
    shows = {
        place: [name for name in names if place in IMPERFECTIONS[name].shows_in] for place in scale.channels
    }
    place = channel
    if place is None:  # the contact is as likely as all joints together
        joints = [key for key, possible in shows.items() if possible and key != CONTACT]
        in_contact = bool(shows[CONTACT]) and (generator.random() < 0.5 or not joints)
        place = CONTACT if in_contact or not joints else str(generator.choice(joints))
    if effect is not None and not any(shows.values()):
        raise InputError(
            f"hidden effect '{effect}': no probing run shows it in this world; name its place and strength"
        )
    if not shows.get(place):
        valid = ", ".join(key for key, possible in shows.items() if possible)
        raise InputError(f"channel '{place}': no hidden effect to draw there. Valid: {valid}")
    kind = IMPERFECTIONS[str(generator.choice(shows[place]))]
    strength = float(np.exp(generator.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    return [kind.at_strength(strength, place, scale, generator)]
