"""Time a diagnosis: one minute of all joints, one hour of one joint, and many short runs.

OPENBLAS_NUM_THREADS=1 python benchmarks/diagnosis_speed.py
"""

import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.study import ModelStudy
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import DEFAULT, find_robot
from palpate.sim_backend.imperfection import IMPERFECTIONS, Imperfection
from palpate.sim_backend.scenario import Scenario

THREE = [
    IMPERFECTIONS["stress_relaxation"](stiffness_n_m=150.0, time_s=0.3),
    IMPERFECTIONS["coulomb_friction"](joint=1, coulomb_nm=0.2),
    IMPERFECTIONS["payload"](joint=3, mass_kg=0.1),
]


def diagnosed(what: str, source: object, model: str | None = None) -> None:
    """Diagnose all channels of a recording over the whole library, and print the duration and the result."""
    started, cpu_s = time.perf_counter(), sum(os.times()[:4])
    study = ModelStudy(source, model=model)
    channels = study.diagnose().channels
    wall_s, cpu_s = time.perf_counter() - started, sum(os.times()[:4]) - cpu_s
    print(f"{what}: {wall_s:.1f} s, processor {cpu_s:.1f} s", *study.source.notes[:1], sep="\n  ")
    for each in channels:
        names = " + ".join(entry.effect for entry in each.accepted) or each.verdict.value
        print(f"  {each.channel}: {names}", flush=True)


def probed(path: Path, hidden: list[Imperfection]) -> Path:
    """Record one minute of the simulated arm."""
    scenario = Scenario().with_hidden(hidden)
    plan = ProbingPlan(repeats=8)
    run_probing(ProbingJob(find_robot(DEFAULT), path, plan, scenario=scenario, seed=7, online=None))
    return path


def long_joint() -> list[ChannelData]:
    """Simulate a joint at 1 kHz: five runs of 10,000 samples, Coulomb friction of ten times the noise."""
    rng, run = np.random.default_rng(0), np.repeat(np.arange(5), 10_000)
    time_s, hz = np.arange(len(run)) * 1e-3 + 2.0 * run, rng.uniform(0.1, 1.2, (5, 3))
    omega = 2.0 * np.pi * hz[run]
    angle, size = omega * time_s[:, None], 0.3 / (1.0 + hz[run] / 0.6)
    q, v = (size * np.sin(angle)).sum(axis=1), (size * omega * np.cos(angle)).sum(axis=1)
    a = -(size * omega**2 * np.sin(angle)).sum(axis=1)
    torque = 0.05 * a + 0.15 * v + 2.0 * np.sin(q) + 0.2 * np.tanh(v / 1e-3)
    torque += 0.02 * rng.standard_normal(len(run))
    return [ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, q, v, a, torque, run, np.full(len(run), -1))]


def short_runs(count: int = 2000, length: int = 25) -> list[ChannelData]:
    """Simulate many short presses of a stiffening object at 100 Hz."""
    rng = np.random.default_rng(0)
    phase = np.tile(np.linspace(0.0, np.pi, length), count)
    deep, w = np.repeat(rng.uniform(0.002, 0.01, count), length), np.pi / (length * 0.01)
    x, v, a = deep * np.sin(phase), deep * w * np.cos(phase), -deep * w**2 * np.sin(phase)
    force = np.maximum(800.0 * x + 10.0 * v + 4e6 * x**3, 0.0) + 0.02 * rng.standard_normal(len(x))
    run = np.repeat(np.arange(count), length)
    signals = (0.01 * np.arange(len(x)) + run, x, v, a, force, run, np.full(len(run), -1))
    return [ChannelData("contact", ChannelKind.CONTACT, *signals)]


def hour_of_joint(swing_hz: float, moving_s: float) -> dict[str, np.ndarray]:
    """Simulate a run of 3.6 million samples with Coulomb friction, moving for `moving_s` of every 600 s."""
    rng, time_s, step_s = np.random.default_rng(0), np.arange(3_600_000) * 1e-3, 1e-3
    share = np.clip(time_s % 600.0 / moving_s, 0.0, 1.0)
    position = 0.8 * np.sin(np.pi * share) ** 2 * np.sin(2.0 * np.pi * swing_hz * time_s)
    velocity = np.gradient(position, step_s)
    torque = 0.05 * np.gradient(velocity, step_s) + 0.2 * velocity + 1.5 * np.sin(position)
    torque += 0.1 * np.tanh(velocity / 1e-3) + 0.02 * rng.standard_normal(len(time_s))
    read = position + 1e-5 * rng.standard_normal(len(time_s))
    return {"time_s": time_s, "position_rad": read, "torque_Nm": torque}


def main() -> None:
    """Time all cases."""
    diagnosed("one joint, 50,000 samples", long_joint(), "pendulum")
    for swing_hz, moving_s in ((0.5, 600.0), (0.5, 20.0), (1 / 1800, 1e9)):
        what = f"one joint, an hour at 1 kHz, swinging at {swing_hz:.2g} Hz"
        diagnosed(what, hour_of_joint(swing_hz, moving_s), "pendulum")
    diagnosed("2,000 short runs", short_runs(), "kelvin_voigt")
    with TemporaryDirectory() as folder:
        for name, hidden in (("nothing", []), ("three effects", THREE)):
            path = probed(Path(folder) / f"{name}.mcap", hidden)
            diagnosed(f"a minute, all channels, {name} hidden", path)


if __name__ == "__main__":
    main()
