"""What is hidden in a world: its effects at work, and effects drawn at random."""

from collections.abc import Sequence
from zlib import crc32

import numpy as np

from robot_io.errors import InputError
from sim_backend.contact_laws import EngineContact
from sim_backend.hooks import Effects
from sim_backend.imperfection import IMPERFECTIONS, Imperfection
from sim_backend.noise_scale import CONTACT, NoiseScale
from sim_backend.scenario import Scenario

WEAKEST, STRONGEST = 5.0, 50.0  # times the noise floor
_STREAM = crc32(b"hidden")  # apart from the sensors' noise, which comes from the same seed


def hidden_effects(imperfections: Sequence[Imperfection], joint_count: int) -> Effects:
    """Everything that these do to one world, with memories of its own.

    They come from the drives to the links, and from the object to the tip. InputError: one is in a joint that
    the arm does not have.
    """
    return sum((entry.effects(joint_count) for entry in imperfections), Effects())


def noise_scale(scenario: Scenario) -> NoiseScale:
    """Noise floors and motion of a probing run under this scenario."""
    return NoiseScale.of(scenario.object.law, scenario.sensors)


def draw_hidden(
    seed: int, channel: str | None = None, *, effect: str | None = None, scenario: Scenario | None = None
) -> list[Imperfection]:
    """One effect at random, 5 to 50 times the noise floor of a probing run with the default plan.

    What is None is drawn too: the channel where it is to show, such as "contact" or "joint_2" (every second
    one is in the contact), and which effect it is. The world that it will be hidden in is that of the
    scenario, or the default one. Equal seeds draw the same.

    Returns the entries for the scenario's section `hidden`.

    InputError: no such channel or effect, or no probing run shows the one in the other.
    """
    scenario = Scenario() if scenario is None else scenario
    scale, generator = noise_scale(scenario), np.random.default_rng([seed, _STREAM])
    names = list(IMPERFECTIONS) if effect is None else [IMPERFECTIONS[effect].name]
    if isinstance(scenario.object.law, EngineContact):
        names = [name for name in names if not IMPERFECTIONS[name].needs_force_law]
    shows = {
        place: [name for name in names if place in IMPERFECTIONS[name].shows_in] for place in scale.channels
    }
    place = _draw_channel(shows, generator) if channel is None else channel
    if effect is not None and not any(shows.values()):
        raise InputError(
            f"hidden effect '{effect}': no probing run shows it in this world; name its place and strength"
        )
    if not shows.get(place):
        valid = ", ".join(key for key, found in shows.items() if found)
        raise InputError(f"channel '{place}': no hidden effect to draw there. Valid: {valid}")
    kind = IMPERFECTIONS[str(generator.choice(shows[place]))]
    strength = float(np.exp(generator.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    return [kind.at_strength(strength, place, scale, generator)]


def _draw_channel(shows: dict[str, list[str]], generator: np.random.Generator) -> str:
    """A channel that has something to draw; the contact is as likely as all joints together."""
    joints = [key for key, found in shows.items() if found and key != CONTACT]
    in_contact = bool(shows[CONTACT]) and (generator.random() < 0.5 or not joints)
    return CONTACT if in_contact or not joints else str(generator.choice(joints))
