"""Read the measured sets into channels, with zero-phase derivatives, runs and the authors' exclusions."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import butter, filtfilt, savgol_filter

from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data.import_file import import_file
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS

SILVERBOX_STEP_S = 2.0**14 / 1e7
_PENDULUM_STEP_S = 0.005
_FULL_DUTY_V = 0.97 * 7.2


def channel(kind: ChannelKind, parts: Iterable[list[np.ndarray]], name: str = "joint_1") -> ChannelData:
    """Build a channel from runs of (time, position, velocity, acceleration, effort)."""
    runs = list(parts)
    run = np.repeat(np.arange(len(runs)), [len(part[0]) for part in runs])
    t, x, v, a, effort = (np.concatenate([part[i] for part in runs]) for i in range(5))
    return ChannelData(name, kind, t, x, v, a, effort, run, np.full(len(t), -1))


def table(path: Path, **only: str | int | list[str]) -> pd.DataFrame:
    """Read the rows of a CSV file; `only` those with the given value, or one of several, in a column."""
    rows = pd.read_csv(path)
    for name, value in only.items():
        rows = rows[rows[name].isin(value if isinstance(value, list) else [value])]
    return rows


def runs(folder: Path, key: str = "run", **only: str | int | list[str]) -> dict[Any, pd.DataFrame]:
    """Read the rows of a set's runs.csv.gz, by run or by another column; `only` as in `table`."""
    return dict(iter(table(folder / "runs.csv.gz", **only).groupby(key, sort=False)))


def signals(rows: pd.DataFrame, *keys: str) -> np.ndarray:
    """Return columns of these rows as numbers, shape (keys, n)."""
    return rows[list(keys)].to_numpy(np.float64).T.copy()


def part(t: np.ndarray, x: np.ndarray, effort: np.ndarray) -> list[np.ndarray]:
    """Return one run for `channel`, with derivatives by differences."""
    v = np.gradient(x, t)
    return [t, x, v, np.gradient(v, t), effort]


def emps(folder: Path) -> ChannelData:
    """Read the linear drive in the band of its authors: motion below 100 Hz, then all signals below 40 Hz.

    They keep every tenth sample. Here all are kept, because times are no better than half a step.
    """
    parts = []
    for number, name in enumerate(("train.csv.gz", "test_pulses.csv.gz")):
        t, q, force = signals(table(folder / name), "time_s", "position_m", "motor_force_N")
        q = filtfilt(*butter(4, 100 / 500), q)
        v = np.gradient(q, 1e-3)
        low = [filtfilt(*butter(4, 40 / 500), signal) for signal in (q, v, np.gradient(v, 1e-3), force)]
        low[1] = v  # unfiltered: friction acts on the motion itself, whose sign a filter would blur
        parts.append([signal[50:-50] for signal in (t + 100.0 * number, *low)])
    return channel(ChannelKind.PRISMATIC, parts)


def pendulum(folder: Path) -> ChannelData:
    """Read the servo with a pendulum; effort: voltage [V]; without saturated, resting and free samples."""
    return channel(ChannelKind.REVOLUTE, [_swing(number, run) for number, run in runs(folder).items()])


def _swing(number: int, run: pd.DataFrame) -> list[np.ndarray]:
    keys = ("time_s", "position_rad", "load_register", "torque_enabled", "input_voltage_V")
    t, q, duty, on, supply = signals(run, *keys)
    volts = np.where(duty > 32767, duty - 65536, duty) / 885.0 * supply
    even = np.arange(t[0], t[-1], _PENDULUM_STEP_S)
    q, volts, on = (np.interp(even, t, signal) for signal in (q, volts, on))
    motion = [savgol_filter(q, 11, 3, deriv=order, delta=_PENDULUM_STEP_S) for order in range(3)]
    volts = savgol_filter(volts, 11, 3)
    kept = (on > 0.999) & (np.abs(volts) < _FULL_DUTY_V) & (np.abs(motion[1]) > 0.2)
    kept[:15] = kept[-15:] = False
    return [signal[kept] for signal in (even + 10.0 * number, *motion, volts)]


def silverbox(folder: Path) -> ChannelData:
    """Read the resonator: eight multisines [V for m and N]."""
    data = signals(table(folder / "silverbox.csv.gz"), "input_voltage_V", "output_voltage_V")
    u, y = (signal - signal.mean() for signal in data)
    spectrum, omega = np.fft.rfft(y), 2j * np.pi * np.fft.rfftfreq(len(y), SILVERBOX_STEP_S)
    v, a = (np.fft.irfft(spectrum * omega**order, len(y)) for order in (1, 2))
    t = np.arange(len(y)) * SILVERBOX_STEP_S
    starts = [40850 + 8692 * number for number in range(8)]
    parts = [[signal[start : start + 2000] for signal in (t, y, v, a, u)] for start in starts]
    return channel(ChannelKind.PRISMATIC, parts)


def load_cell(folder: Path, number: int) -> ChannelData:
    """Read one of two cells under weights; position: force [kN for m], effort: reading [counts]."""
    keys = ("time_s", "nominal_force_N", f"load_cell_{number}_counts", "settled")
    t, force, counts, settled = signals(table(folder / "load_cell.csv"), *keys)
    # two successive levels make a run: one level alone cannot tell a gain from a bias
    pair = np.concatenate([[0], np.cumsum(np.diff(force) != 0)]) // 2
    kept = [(settled == 1) & (pair == run) for run in range(int(pair.max()) + 1)]
    parts = [[t[k], 1e-3 * force[k], 0.0 * t[k], 0.0 * t[k], counts[k]] for k in kept if k.any()]
    return channel(ChannelKind.PRISMATIC, parts, f"cell_{number}")


def indentation(folder: Path) -> ChannelData:
    """Read the soft specimen P002: ramp, hold and release, one run for each recording."""
    recordings = runs(folder, "specimen")
    parts = []
    for number in (9, 10, 11, 12, 13):
        t, x, force = signals(recordings[f"230515-P002-{number}"], "time_s", "displacement_m", "force_N")
        parts.append([t + 200.0 * number, *part(t, x, force - force[:3].mean())[1:]])
    return channel(ChannelKind.CONTACT, parts, "contact")


def servo(folder: Path, log: str, motor: int) -> ChannelData:
    """Read a servo held at home and pulled back and forth; position: pull [-1, 1], effort: counts.

    Every two pulls make a run. Samples less than 0.8 s after a commanded move are omitted.
    """
    counts, telemetry = 4096 / 2 / np.pi, table(folder / "telemetry.csv.gz", log=log)

    def signal(number: int, key: str) -> np.ndarray:
        return telemetry.loc[telemetry["motor_id"] == number, key].to_numpy(np.float64)

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
    parts = []
    for start, stop in pairwise(np.linspace(0, count, 7).astype(int)):
        kept = np.arange(start, stop)[home[start:stop]]
        if len(kept) > 10:
            parts.append(part(t[kept], x[kept], y[kept] - np.nanmean(y[home])))
    return channel(ChannelKind.REVOLUTE, parts)


def presses(folder: Path, position: str, gap_s: float, only: dict[str, Any]) -> ChannelData:
    """Read runs of a contact, `gap_s` apart; `position`: column of the depth [m], `only` as in `table`."""
    parts = []
    for number, run in enumerate(runs(folder, **only).values()):
        t, x, force = signals(run, "time_s", position, "force_N")
        parts.append(part(t + gap_s * number, x, force))
    return channel(ChannelKind.CONTACT, parts, "contact")


TX40_JOINTS = 6
_STILL_FROM_S = 7.7  # TX40: the arm no longer moves
_JAW_RATIO = 1.04  # surgical tool: torque at the disc per torque of the jaw, from its README


def cogging_map(folder: Path) -> ChannelData:
    """Read the holding torque along one turn out and back; each quarter is a run.

    The motor was held nearly still at each position; derivatives are computed as for a file.
    """
    parts = []
    for run in (1, 2):
        data = table(folder / "mapping.csv.gz", run=run)
        t, q, torque = signals(data, "time_s", "position_rad", "torque_Nm")
        for part in np.array_split(np.arange(len(t)), 4):
            made = differentiate(t[part], q[part], np.zeros(len(part), dtype=np.int64))
            parts.append([t[part] + 1e5 * run, q[part], made.velocity, made.acceleration, torque[part]])
    return channel(ChannelKind.REVOLUTE, parts)


def cogging_motion(folder: Path, run: int, band_hz: float) -> ChannelData:
    """Read a recording in motion on an even grid, low-pass filtered, in five pieces."""
    data = table(folder / "motion.csv.gz", run=run)
    read_s, *read = signals(data, "time_s", "position_rad", "torque_Nm")
    t = np.arange(read_s[0] + 0.02, read_s[-1] - 0.02, 1e-3)
    q, torque = (filtfilt(*butter(4, band_hz / 500), np.interp(t, read_s, signal)) for signal in read)
    v = np.gradient(q, 1e-3)
    kept = [signal[300:-300:2] for signal in (t, q, v, np.gradient(v, 1e-3), torque)]
    edges = np.linspace(0, len(kept[0]), 6).astype(int)
    parts = [[signal[start:stop] for signal in kept] for start, stop in pairwise(edges)]
    return channel(ChannelKind.REVOLUTE, parts)


def tool(folder: Path, name: str) -> ChannelData:
    """Read the torque at the driven disc minus the torque of the jaw, which is the load [N m]."""
    parts, loads = [], []
    for number, of_run in enumerate(runs(folder, tool=name).values()):
        t, q, torque, jaw = signals(of_run, "time_s", "position_rad", "torque_Nm", "jaw_torque_Nm")
        v, a = (savgol_filter(q, 7, 2, deriv=order, delta=0.01) for order in (1, 2))
        load = _JAW_RATIO * jaw
        parts.append([signal[50:-50] for signal in (t + 100.0 * number, q, v, a, torque - load)])
        loads.append(load[50:-50])
    return replace(channel(ChannelKind.REVOLUTE, parts), context={"load": np.concatenate(loads)})


def tx40(folder: Path) -> tuple[list[ChannelData], list[Model]]:
    """Read six joints, below 60 Hz, every tenth sample, and build models with free base parameters."""
    data, numbers = table(folder / "runs.csv.gz"), range(1, TX40_JOINTS + 1)
    low = butter(4, 60 / 500)
    columns = {"time_s": data["time_s"].to_numpy(), "run": data["run"].to_numpy()}
    for i in numbers:
        q, torque = (filtfilt(*low, each) for each in signals(data, f"position_{i}_rad", f"torque_{i}_Nm"))
        columns[f"position_{i}_rad"], columns[f"velocity_{i}_rad_s"] = q, (v := np.gradient(q, 1e-3))
        columns[f"acceleration_{i}_rad_s2"], columns[f"torque_{i}_Nm"] = np.gradient(v, 1e-3), torque
    kept = np.arange(50, len(data) - 50, 10)
    kept = kept[columns["time_s"][kept] < _STILL_FROM_S]
    with TemporaryDirectory() as place:
        path = Path(place) / "tx40.csv"
        rows = np.column_stack(list(columns.values()))[kept]
        np.savetxt(path, rows, fmt="%.10g", delimiter=",", header=",".join(columns), comments="")
        channels = import_file(path).channels
    base = MODELS["rigid_body_fitted"]()
    urdf = (folder / "tx40.urdf").read_text()
    contexts = [ModelContext(i, Arm(urdf, "tool0")) for i in range(TX40_JOINTS)]
    pairs = list(zip(channels, contexts, strict=True))
    return [base.prepare(one, context) for one, context in pairs], [base.build(c) for c in contexts]
