"""Hidden effects of a world, random or named, and the sealed answer beside a session."""

import base64
import binascii
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from pathlib import Path
from zlib import crc32

import numpy as np

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.atomic_write import atomic_write
from palpate.sim_backend.contact_laws import ObjectLaw
from palpate.sim_backend.contact_laws.standard import EngineContact
from palpate.sim_backend.hooks import HiddenEffects
from palpate.sim_backend.imperfection import IMPERFECTIONS, Imperfection, parse_imperfection
from palpate.sim_backend.noise_scale import CONTACT, NoiseScale
from palpate.sim_backend.scenario import Scenario

WEAKEST, STRONGEST = 5.0, 50.0  # multiples of the noise floor
_STREAM = crc32(b"hidden")  # separate from the sensors' noise, which uses the same seed


def hidden_effects(imperfections: Sequence[Imperfection], joint_count: int) -> HiddenEffects:
    """Make the effects of one world, each with its own memory.

    Args:
        imperfections: hidden effects in order, from the drives to the links and from the object to the tip.
        joint_count: number of joints of the arm.

    Raises:
        InputError: an effect is in a joint that the arm does not have.
    """
    return sum((entry.effects(joint_count) for entry in imperfections), HiddenEffects())


def noise_scale(scenario: Scenario) -> NoiseScale:
    """Compute noise floors and motion of a probing run.

    Args:
        scenario: the world.
    """
    force, torque = scenario.sensors.force, scenario.sensors.torque
    return NoiseScale(
        contact_noise_n=_floor(force.noise_std_n, force.resolution_n),
        joint_noise_nm=_floor(torque.noise_std_nm, torque.resolution_nm),
        depth_m=_depth_m(scenario.object.law, 10.0),
    )


def _floor(noise: float, resolution: float) -> float:
    """Standard deviation of noise and rounding together; never zero, so that strengths stay finite."""
    return max(hypot(noise, resolution / sqrt(12.0)), 1e-9)


def _depth_m(law: ObjectLaw, force_n: float) -> float:
    """Depth at which a law holds a force at rest, by bisection [m]."""
    low_m, high_m = 0.0, 1.0
    for _ in range(60):
        middle_m = 0.5 * (low_m + high_m)
        if law.force_n(middle_m, 0.0) < force_n:
            low_m = middle_m
        else:
            high_m = middle_m
    return high_m


def draw_hidden(
    seed: int, channel: str | None = None, *, effect: str | None = None, scenario: Scenario | None = None
) -> list[Imperfection]:
    """Draw one effect at random, 5 to 50 times the noise floor of a probing run with the default plan.

    Equal seeds give equal effects.

    Args:
        seed: seed of the draw.
        channel: channel that shows the effect, such as "contact" or "joint_2"; None to draw it (the contact
            with a probability of one half).
        effect: name of the effect; None to draw it.
        scenario: the world; None for the default one.

    Returns:
        Entries for the scenario's section `hidden`.

    Raises:
        InputError: the channel or effect does not exist, or no probing run shows the effect in the channel.
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


SUFFIX = ".sealed"
_TITLE = "palpate sealed answer, version 1"
_HOW = "What was hidden in the session of this name. To open it: palpate reveal"
_MAX_BYTES = 1_000_000


@dataclass(frozen=True)
class SealedAnswer:
    """Hidden effects of one session."""

    hidden: tuple[Imperfection, ...]  # the effects
    seed: int | None  # seed of the draw; None if a scenario named them
    made_utc: str  # creation time of the session, from its metadata
    mark: str = ""  # random text, also in the session; distinguishes answers of equal name


def sealed_path(session: str | Path) -> Path:
    """Return the path of a session's sealed answer: its whole name with a suffix.

    Args:
        session: path of the session file.
    """
    return Path(f"{session}{SUFFIX}")


def seal(session: str | Path, answer: SealedAnswer) -> Path:
    """Write the sealed answer beside a session file, completely or not at all, without replacing a file.

    Args:
        session: path of the session file.
        answer: answer to seal.

    Raises:
        InputError: the file already exists, or cannot be written.
    """
    path = sealed_path(session)
    data = json.dumps(vars(answer) | {"hidden": [entry.describe() for entry in answer.hidden]})
    try:
        with atomic_write(path, replace=False) as unfinished:
            code = base64.encodebytes(zlib.compress(data.encode()))
            unfinished.write_bytes(f"{_TITLE}\n{_HOW}\n\n".encode() + code)
    except FileExistsError as error:
        raise InputError(f"{path}: already exists, and a sealed answer never replaces a file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    return path


def unseal(path: str | Path) -> SealedAnswer:
    """Open a sealed answer.

    Args:
        path: path of the sealed file.

    Raises:
        InputError: the sealed answer does not exist, is damaged, or has another version.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    title, *rest = content.split(b"\n")
    if title.strip() != _TITLE.encode():
        raise InputError(f"{path}: not a sealed answer; its first line would be '{_TITLE}'")
    try:
        return _parse(b"".join(rest[1:]), len(content))
    except (ValueError, KeyError, TypeError, binascii.Error, zlib.error) as error:
        raise InputError(f"{path}: damaged, its answer cannot be read ({error!s:.100})") from error


def _parse(code: bytes, size: int) -> SealedAnswer:
    if size > _MAX_BYTES:
        raise ValueError(f"larger than {_MAX_BYTES} bytes")
    inflater = zlib.decompressobj()
    text = inflater.decompress(base64.b64decode(code, validate=True), _MAX_BYTES)
    if not inflater.eof:
        raise ValueError("cut off, or larger than any answer")
    answer = json.loads(text)
    seed, made_utc, mark = answer["seed"], answer["made_utc"], answer.get("mark", "")
    if not (isinstance(seed, int | None) and isinstance(made_utc, str) and isinstance(mark, str)):
        raise TypeError("seed, date or mark is of the wrong type")
    return SealedAnswer(tuple(parse_imperfection(entry) for entry in answer["hidden"]), seed, made_utc, mark)
