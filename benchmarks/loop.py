"""Measure the processor time of a tick in probing runs of the simulated follower on simulated time.

The first run writes a session and estimates online; the others run in memory, as in a sweep, in each engine.
Without other load the shortest of several runs counts.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from harness import print_table

from palpate.control.loop.timing import TickDurations
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.session import Samples
from palpate.runs.probing import ProbingJob, probe_in_memory, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.engines import EngineName, installed_engines
from palpate.sim_backend.scenario import Scenario

SECTIONS = [name for name in TickDurations._fields if name not in ("observer_s", "lateness_s")]
REPEATS = 7


def with_session() -> None:
    """Probe the default object at three speeds, with online estimation, as fast as the machine can."""
    with TemporaryDirectory() as folder:
        job = ProbingJob(find_robot("follower"), Path(folder) / "probing.mcap", ProbingPlan())
        run = run_probing(job).loop
    run.raise_for_trip()
    rows = [
        (name, *(f"{1e6 * time_s:.1f}" for time_s in (each.p50_s, each.p99_s, each.p999_s, each.max_s)))
        for name, each in run.timing.items()
    ]
    title = "Probing on simulated time; the engine steps between the ticks [us]"
    print_table(title, ("section", "p50", "p99", "p99.9", "max"), rows)
    ratio = run.duration_s / run.wall_s
    print(f"{run.one_line()}; {run.duration_s:.1f} s simulated, {ratio:.1f} times real time")


def in_memory(engine: EngineName) -> tuple[float, Samples]:
    """Return the processor time per tick [s] of the fastest of several short runs, and its tick count."""
    robot, scenario = find_robot("follower"), Scenario().with_engine(engine)
    plan = ProbingPlan(speeds_m_s=(0.15,), hold_s=0.0)
    runs = []
    for _ in range(REPEATS):
        begun_s = time.process_time()
        ticks = probe_in_memory(robot, scenario, plan)
        runs.append(((time.process_time() - begun_s) / len(ticks), ticks))
    return min(runs, key=lambda run: run[0])


def main() -> None:
    """Print all figures."""
    with_session()
    sections = (name.removesuffix("_s") for name in SECTIONS)
    headers, rows = ("engine", *sections, "physics and rest", "tick", "times real time"), []
    for engine in installed_engines():
        tick_s, ticks = in_memory(engine)
        sections_s = [float(np.median(ticks[name])) for name in SECTIONS]
        times_s = (*sections_s, tick_s - sum(sections_s), tick_s)
        rows.append((engine, *(f"{1e6 * time_s:.1f}" for time_s in times_s), f"{1e-3 / tick_s:.1f}"))
    print_table(f"In memory, the quickest of {REPEATS} runs [us of processor time]", headers, rows)


if __name__ == "__main__":
    main()
