"""Reads the measured sets into channels: zero-phase derivatives, runs, what their authors left out."""

import csv
import gzip
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.signal import butter, filtfilt, savgol_filter

from palpate.estimation.channel import ChannelData, ChannelKind

SILVERBOX_STEP_S = 2.0**14 / 1e7
_PENDULUM_STEP_S = 0.005
_FULL_DUTY_V = 0.97 * 7.2


def channel(kind: ChannelKind, parts: Iterable[list[np.ndarray]], name: str = "joint_1") -> ChannelData:
    """A channel out of runs of (time, position, velocity, acceleration, effort)."""
    runs = list(parts)
    run = np.repeat(np.arange(len(runs)), [len(part[0]) for part in runs])
    t, x, v, a, effort = (np.concatenate([part[i] for part in runs]) for i in range(5))
    return ChannelData(name, kind, t, x, v, a, effort, run, np.full(len(t), -1))


def table(path: Path) -> np.ndarray:
    """All rows of a CSV of numbers."""
    return np.genfromtxt(path, delimiter=",", names=True)


def rows(path: Path) -> list[dict[str, str]]:
    """All rows of a CSV with words in it."""
    with gzip.open(path, "rt") as file:
        return list(csv.DictReader(file))


def runs(folder: Path, key: str = "run", **only: str) -> dict[str, list[dict[str, str]]]:
    """Rows of a set's runs.csv.gz, by run or by another column; `only` those with this in a column."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in rows(folder / "runs.csv.gz"):
        if all(row[name] == value for name, value in only.items()):
            found.setdefault(row[key], []).append(row)
    return found


def signals(run: list[dict[str, str]], *keys: str) -> list[np.ndarray]:
    """Columns of these rows as numbers."""
    return [np.array([float(row[key]) for row in run]) for key in keys]


def part(t: np.ndarray, x: np.ndarray, effort: np.ndarray) -> list[np.ndarray]:
    """One run for `channel`, with derivatives by difference."""
    v = np.gradient(x, t)
    return [t, x, v, np.gradient(v, t), effort]


def emps(folder: Path) -> ChannelData:
    """The linear drive in the band of its authors: 100 Hz for the motion, then all below 40 Hz.

    They keep every tenth sample. Here all are kept: times are no better than half a step.
    """
    parts = []
    for number, name in enumerate(("train.csv.gz", "test_pulses.csv.gz")):
        data = table(folder / name)
        q = filtfilt(*butter(4, 100 / 500), data["position_m"])
        v = np.gradient(q, 1e-3)
        signals = (q, v, np.gradient(v, 1e-3), data["motor_force_N"])
        low = [filtfilt(*butter(4, 40 / 500), signal)[50:-50] for signal in signals]
        # the sign of motion is lost in no filter: friction acts on the motion itself
        low[1] = v[50:-50]
        parts.append([data["time_s"][50:-50] + 100.0 * number, *low])
    return channel(ChannelKind.PRISMATIC, parts)


def pendulum(folder: Path) -> ChannelData:
    """The servo with a pendulum; the effort is the voltage [V]. Saturated, standing, free ones left out."""
    return channel(ChannelKind.REVOLUTE, [_swing(int(number), run) for number, run in runs(folder).items()])


def _swing(number: int, run: list[dict[str, str]]) -> list[np.ndarray]:
    keys = ("time_s", "position_rad", "load_register", "torque_enabled", "input_voltage_V")
    t, q, duty, on, supply = signals(run, *keys)
    volts = np.where(duty > 32767, duty - 65536, duty) / 885.0 * supply
    even = np.arange(t[0], t[-1], _PENDULUM_STEP_S)
    q, volts, on = (np.interp(even, t, signal) for signal in (q, volts, on))
    motion = [savgol_filter(q, 11, 3, deriv=order, delta=_PENDULUM_STEP_S) for order in range(3)]
    volts = savgol_filter(volts, 11, 3)
    kept = (on > 0.999) & (np.abs(volts) < _FULL_DUTY_V) & (np.abs(motion[1]) > 0.2)
    kept[:15] = kept[-15:] = False
    return [(even + 10.0 * number)[kept], *(signal[kept] for signal in motion), volts[kept]]


def silverbox(folder: Path) -> ChannelData:
    """The resonator: eight multisines [V for m and N]."""
    data = table(folder / "silverbox.csv.gz")
    u, y = (data[key] - data[key].mean() for key in ("input_voltage_V", "output_voltage_V"))
    spectrum, omega = np.fft.rfft(y), 2j * np.pi * np.fft.rfftfreq(len(y), SILVERBOX_STEP_S)
    v, a = (np.fft.irfft(spectrum * omega**order, len(y)) for order in (1, 2))
    t = np.arange(len(y)) * SILVERBOX_STEP_S
    starts = [40850 + 8692 * number for number in range(8)]
    parts = [[signal[start : start + 2000] for signal in (t, y, v, a, u)] for start in starts]
    return channel(ChannelKind.PRISMATIC, parts)


def load_cells(folder: Path) -> list[ChannelData]:
    """Two cells under weights; force as the position [kN for m], reading as the effort [counts]."""
    data = table(folder / "load_cell.csv")
    settled = data["settled"] == 1
    step = np.concatenate([[0], np.cumsum(np.diff(data["nominal_force_N"]) != 0)])
    found = []
    for number in (1, 2):
        parts = []
        # a level and the next together make a run: one level alone cannot tell a gain from a bias
        for pair in range(0, int(step.max()) + 1, 2):
            kept = settled & ((step == pair) | (step == pair + 1))
            force = data["nominal_force_N"][kept]
            zero = np.zeros_like(force)
            parts.append(
                [data["time_s"][kept], 1e-3 * force, zero, zero, data[f"load_cell_{number}_counts"][kept]]
            )
        found.append(channel(ChannelKind.PRISMATIC, [p for p in parts if len(p[0])], f"cell_{number}"))
    return found


def indentation(folder: Path) -> ChannelData:
    """The soft specimen P002, ramp, hold and release, one run a recording."""
    recordings = runs(folder, "specimen")
    parts = []
    for number in (9, 10, 11, 12, 13):
        t, x, force = signals(recordings[f"230515-P002-{number}"], "time_s", "displacement_m", "force_N")
        parts.append([t + 200.0 * number, *part(t, x, force - force[:3].mean())[1:]])
    return channel(ChannelKind.CONTACT, parts, "contact")


def servo(folder: Path, log: str, motor: int) -> ChannelData:
    """A servo held at home and pulled to and fro; pull [-1, 1] as the position, its counts as the effort.

    Each two pulls make a run. Samples less than 0.8 s after a commanded move are left out.
    """
    counts = 4096 / 2 / np.pi
    of_log = [row for row in rows(folder / "telemetry.csv.gz") if row["log"] == log]

    def signal(number: int, key: str) -> np.ndarray:
        return np.array([float(row[key] or "nan") for row in of_log if int(row["motor_id"]) == number])

    count = min(len(signal(number, "time_s")) for number in (motor, 3, 4))
    pull = [
        np.clip((signal(number, "position_rad")[:count] * counts - start) / (stop - start), 0.0, 1.0)
        for number, (start, stop) in {3: (1747, 2247), 4: (2347, 1847)}.items()
    ]
    x, y = pull[1] - pull[0], signal(motor, "position_rad")[:count] * counts
    target, t = signal(motor, "target_position_rad")[:count] * counts, signal(motor, "time_s")[:count]
    home = np.abs(target - 2047) < 60
    for i in np.flatnonzero(np.diff(target)) + 1:
        home[i : i + 8] = False
    home &= np.isfinite(x + y)
    edges = np.linspace(0, count, 7).astype(int)
    parts = []
    for start, stop in pairwise(edges):
        kept = np.arange(count)[start:stop][home[start:stop]]
        if len(kept) > 10:
            parts.append(part(t[kept], x[kept], y[kept] - np.nanmean(y[home])))
    return channel(ChannelKind.REVOLUTE, parts)
