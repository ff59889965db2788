"""Other ways in which sessions come about and are read.

An arm's encoders, stiff objects, coarse steps, files without a velocity, other controllers' motions, other
numbers of runs. Each way is a row of its own in the tables, so that the rows of the usual way can be compared
with earlier ones.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import chirp, savgol_filter
from synthetic.motion import RATE_HZ, Motion, assemble, presses, swings

from estimation.channel import ChannelData, ChannelKind
from estimation.data.import_file import import_file

_UPPER_M, _FORE_M = 0.32, 0.27
Paths = Callable[[np.random.Generator, float], Motion]  # with the depth or the size of a swing


@dataclass(frozen=True)
class Way:
    """How a session is made."""

    motion: Paths  # draws it
    stiffness: tuple[float, float] = (2.6, 3.3)  # decades of a contact's stiffness [N/m]
    # Least and most of the RMS that steps of two encoders make of a contact's force, over the force noise;
    # None for the usual single, fine encoder.
    steps_to_noise: tuple[float, float] | None = None
    per_turn: int | None = None  # of a joint's encoder; None for the usual
    gives_velocity: bool = True  # whether the file has one


def _path(seconds: Sequence[float], heights: Sequence[float]) -> np.ndarray:
    """Minimum-jerk moves from height to height."""
    parts = [np.full(200, heights[0])]
    for time_s, before, after in zip(seconds, heights[:-1], heights[1:], strict=True):
        s = np.linspace(0.0, 1.0, round(time_s * RATE_HZ))
        parts.append(before + (after - before) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
    return np.concatenate([*parts, np.full(200, heights[-1])])


def smooth_presses(rng: np.random.Generator, depth: float) -> Motion:
    """Minimum-jerk presses with a hold, four to six of them, each at its own speed."""
    paths = []
    for _ in range(rng.integers(4, 7)):
        deep, slow = depth * rng.uniform(0.6, 1.1), rng.uniform(0.3, 1.5)
        paths.append(
            _path([slow, 0.8, 0.4, 1.2 * slow], [-0.4 * depth, deep, deep, 0.8 * deep, -0.4 * depth])
        )
    return assemble(paths)


def shaken_presses(rng: np.random.Generator, depth: float) -> Motion:
    """A chirp that rides on a hold, four to six times."""
    paths = []
    for _ in range(rng.integers(4, 7)):
        deep, last = depth * rng.uniform(0.5, 0.8), rng.uniform(2.0, 4.0)
        t = np.arange(round(last * RATE_HZ)) / RATE_HZ
        ride = (
            0.4 * deep * np.sin(np.pi * t / last) ** 2 * chirp(t, 0.3, last, rng.uniform(2.0, 6.0), phi=-90)
        )
        into = _path([rng.uniform(0.3, 1.0)], [-0.4 * depth, deep])
        paths.append(np.concatenate([into, deep + ride, into[::-1]]))
    return assemble(paths)


def guided_presses(rng: np.random.Generator, depth: float) -> Motion:
    """A hand that presses as it likes, four to six times."""
    paths = []
    for _ in range(rng.integers(4, 7)):
        walk = gaussian_filter1d(rng.standard_normal(5000), rng.uniform(100.0, 300.0))
        walk = (walk - walk.min()) / np.ptp(walk)
        paths.append(depth * (rng.uniform(1.1, 1.4) * walk - 0.3))
    return assemble(paths)


def moves(rng: np.random.Generator, size: float) -> Motion:
    """A joint that goes from posture to posture and rests there, in four or five runs."""
    paths = []
    for _ in range(rng.integers(4, 6)):
        heights = size * rng.uniform(-1.2, 1.2, 8)
        seconds = np.abs(np.diff(heights)) / rng.uniform(0.5, 2.0) + 0.4
        seconds[1::3] += 0.3
        paths.append(_path(seconds.tolist(), heights.tolist()))
    return assemble(paths)


def sweeps(rng: np.random.Generator, size: float) -> Motion:
    """A chirp about a posture of its own, in four or five runs."""
    paths = []
    for _ in range(rng.integers(4, 6)):
        t = np.arange(round(8.0 * RATE_HZ)) / RATE_HZ
        wave = chirp(t, 0.1, 8.0, rng.uniform(1.0, 2.0), phi=-90) / (1.0 + t / 4.0)
        paths.append(size * (rng.uniform(-0.4, 0.4) + wave))
    return assemble(paths)


def usual_swings(rng: np.random.Generator, size: float) -> Motion:
    """Swings of several frequencies, other in each of six runs."""
    return swings(rng, size=size)


WAYS: dict[ChannelKind, dict[str, Way]] = {
    ChannelKind.CONTACT: {
        "several encoders": Way(presses, steps_to_noise=(0.1, 1.0)),
        "stiff object": Way(presses, (3.6, 4.4), (1.0, 3.0)),
        "no velocity given": Way(presses, steps_to_noise=(0.1, 1.0), gives_velocity=False),
        "minimum-jerk moves": Way(smooth_presses, steps_to_noise=(0.1, 1.0)),
        "chirp on a hold": Way(shaken_presses, steps_to_noise=(0.1, 1.0)),
        "hand-guided": Way(guided_presses, steps_to_noise=(0.1, 1.0), gives_velocity=False),
    },
    ChannelKind.REVOLUTE: {
        "4096 a turn": Way(usual_swings, per_turn=4096),
        "4096, no velocity": Way(usual_swings, per_turn=4096, gives_velocity=False),
        "no velocity given": Way(usual_swings, per_turn=2**17, gives_velocity=False),
        "moves and rests": Way(moves, per_turn=2**17),
        "chirp": Way(sweeps, per_turn=2**17),
    },
}


def steps_seen(way: Way, x: np.ndarray, noise_m: float, rng: np.random.Generator) -> np.ndarray:
    """The position as its encoders tell it.

    Args:
        way: its encoders.
        x: the true one.
        noise_m: position noise that makes as much force as the force noise, for a contact.
        rng: of the case.
    """
    if way.per_turn:
        step = 2.0 * np.pi / way.per_turn
        return np.round(x / step) * step
    if way.steps_to_noise is None:
        return x
    share = np.exp(rng.uniform(*np.log(way.steps_to_noise)))
    # two rounding errors of about the same lever
    step = share * noise_m * np.sqrt(12.0 / 2.0) / _FORE_M
    return _by_two_links(x, (step, step * rng.uniform(0.5, 0.8)))


def _by_two_links(x: np.ndarray, steps_rad: tuple[float, float]) -> np.ndarray:
    """A tip that goes down at a constant reach; angles of both links are rounded to their steps."""
    down, reach = 0.1 + x, 0.35
    bend = np.arccos((reach**2 + down**2 - _UPPER_M**2 - _FORE_M**2) / (2.0 * _UPPER_M * _FORE_M))
    first = np.arctan2(down, reach) - np.arctan2(_FORE_M * np.sin(bend), _UPPER_M + _FORE_M * np.cos(bend))
    first, bend = (np.round(q / step) * step for q, step in zip((first, bend), steps_rad, strict=True))
    return _UPPER_M * np.sin(first) + _FORE_M * np.sin(first + bend) - 0.1


def derived(x: np.ndarray, motion: Motion, order: int) -> np.ndarray:
    """A derivative by cubic fits over 25 or 41 ms, as a user works it out."""
    out = np.empty_like(x)
    for rows in motion.parts():
        out[rows] = savgol_filter(x[rows], 25 if order == 1 else 41, 3, deriv=order, delta=1.0 / RATE_HZ)
    return out


def imported(way: Way, kind: ChannelKind, motion: Motion, x: np.ndarray, effort: np.ndarray) -> ChannelData:
    """The channel, by way of a CSV file."""
    touching = kind is ChannelKind.CONTACT
    columns = {
        "time_s": motion.time_s,
        "displacement_m" if touching else "position_rad": x,
        "force_N" if touching else "torque_Nm": effort,
        "run": motion.run.astype(float),
    }
    if way.gives_velocity:
        columns["velocity_m_s" if touching else "velocity_rad_s"] = derived(x, motion, 1)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "session.csv"
        rows = np.column_stack(list(columns.values()))
        np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
        return import_file(path).channels[0]
