"""Measure the processor time of a tick in probing runs of the simulated follower on simulated time.

The first run writes a session and estimates online; the others run in memory, as in a sweep, in each engine.
Without other load the shortest of several runs counts.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from harness import print_table

from palpate.control.probing.plan import ProbingPlan
from palpate.runs.probing import ProbingJob, probe_in_memory, run_probing
from palpate.runs.robots import find_robot
from palpate.sim_backend.engines import installed_engines
from palpate.sim_backend.scenario import Scenario

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


def main() -> None:
    """Print all figures."""
    with_session()
    robot, plan = find_robot("follower"), ProbingPlan(speeds_m_s=(0.15,), hold_s=0.0)
    for engine in installed_engines():
        ticks_s = []
        for _ in range(REPEATS):
            begun_s = time.process_time()
            ticks = probe_in_memory(robot, Scenario().with_engine(engine), plan)
            ticks_s.append((time.process_time() - begun_s) / len(ticks))
        tick_s = min(ticks_s)
        print(f"in memory, {engine}: {1e6 * tick_s:.1f} us a tick, {1e-3 / tick_s:.1f} times real time")


if __name__ == "__main__":
    main()
