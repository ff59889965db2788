"""Reads measured joints into channels: a motor's cogging, a cable-driven tool, an arm of six joints."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.signal import butter, filtfilt, savgol_filter

from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data.import_file import import_file
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS

from .read import channel, runs, signals, table

TX40_JOINTS = 6
_STILL_FROM_S = 7.7  # TX40: the arm does not move any more
_JAW_RATIO = 1.04  # surgical tool: of the jaw's torque at the disc, as its README says


def cogging_map(folder: Path) -> ChannelData:
    """Holding torque along one turn out and back, each quarter a run.

    It was held nearly still at each position; its derivatives are made as those of a file are.
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
    """One of the recordings in motion, on an even grid, below a frequency; in five pieces."""
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
    """Torque at the driven disc less what the jaw carries; that is the load [N m]."""
    parts, loads = [], []
    for number, of_run in enumerate(runs(folder, tool=name).values()):
        t, q, torque, jaw = signals(of_run, "time_s", "position_rad", "torque_Nm", "jaw_torque_Nm")
        v, a = (savgol_filter(q, 7, 2, deriv=order, delta=0.01) for order in (1, 2))
        load = _JAW_RATIO * jaw
        parts.append([signal[50:-50] for signal in (t + 100.0 * number, q, v, a, torque - load)])
        loads.append(load[50:-50])
    return replace(channel(ChannelKind.REVOLUTE, parts), context={"load": np.concatenate(loads)})


def tx40(folder: Path) -> tuple[list[ChannelData], list[Model]]:
    """Six joints and their models with free base parameters, all below 60 Hz, every tenth sample."""
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
