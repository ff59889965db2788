"""What a tick costs, and how punctual the loop is.

Three parts: a probing run of the simulated follower on simulated time (the whole stack, with a session), the
loop alone around a robot that does nothing, and wake-ups in real time beside cyclictest's.
"""

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path

import cyclictest
import numpy as np
from idle_arm import JOINTS, IdleTask, idle_robot
from rich.console import Console
from rich.table import Column, Table

from control.loop.loop import run_loop
from control.loop.realtime import realtime
from control.loop.result import LoopResult
from control.loop.tick_record import tick_stream
from control.loop.timing import SectionTiming
from control.probing.plan import ProbingPlan
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import find_robot
from robot_io.clock import Clock, MonotonicClock, SimulatedClock
from robot_io.session import SessionMetadata, SessionWriter

RATE_HZ = 1000.0


def probing(session: Path) -> LoopResult:
    """Three speeds on the default object with online estimation, as fast as the machine can."""
    result = run_probing(ProbingJob(find_robot("follower"), session, ProbingPlan())).loop
    result.raise_for_trip()
    return result


def idle(session: Path, clock: Clock, seconds: float, repeats: int = 1) -> list[LoopResult]:
    """Only the loop, the guard and the log."""
    robot, guard = idle_robot(clock)
    ticks = round(seconds * RATE_HZ)
    slots = ticks * repeats  # all of them fit: the loop alone is faster than the session's writer
    writer = SessionWriter(session, [tick_stream(JOINTS)], SessionMetadata(), ring_slots=slots)
    with robot, writer as log:
        return [run_loop(robot, guard, IdleTask(ticks), clock, log, rate_hz=RATE_HZ) for _ in range(repeats)]


def show_timing(console: Console, title: str, rows: Mapping[str, SectionTiming]) -> None:
    """Print percentiles in microseconds."""
    table = Table("section", *(Column(name, justify="right") for name in ("p50", "p99", "p99.9", "max")))
    for name, section in rows.items():
        times_s = (section.p50_s, section.p99_s, section.p999_s, section.max_s)
        table.add_row(name, *(f"{1e6 * time_s:.1f}" for time_s in times_s))
    console.print(f"[bold]{title} [us][/bold]", table)


def own_cost_s(result: LoopResult) -> float:
    """Time per tick outside of driver, task and guard: grid, clock, record, log, timing [s]."""
    others_s = sum(result.timing[name].p50_s for name in ("read", "control", "guard", "write"))
    return result.wall_s / result.ticks - others_s


def show_probing(console: Console, folder: Path) -> None:
    """The whole stack on simulated time."""
    run = probing(folder / "probing.mcap")
    show_timing(console, "Probing run on simulated time; PyBullet steps between the ticks", run.timing)
    ratio = run.duration_s / run.wall_s
    console.print(f"{run.one_line()}; {run.duration_s:.1f} s simulated, {ratio:.1f} times real time\n")


def show_own_cost(console: Console, folder: Path) -> None:
    """The loop without what it calls."""
    costs_s = [own_cost_s(run) for run in idle(folder / "alone.mcap", SimulatedClock(), 0.5, repeats=40)]
    cost_us, worst_us = 1e6 * float(np.median(costs_s)), 1e6 * max(costs_s)
    console.print(
        f"The loop itself: {cost_us:.1f} us per tick beside driver, task and guard "
        f"(median of {len(costs_s)} runs of half a second; highest {worst_us:.1f} us)\n"
    )


def show_lateness(console: Console, folder: Path, seconds: float) -> None:
    """Wake-ups of an idle robot in real time."""
    (plain,) = idle(folder / "plain.mcap", MonotonicClock(), seconds)
    with realtime() as help_given:
        (helped,) = idle(folder / "helped.mcap", MonotonicClock(), seconds)
    kernel = cyclictest.lateness(seconds, RATE_HZ)
    rows = {"default scheduling": plain.timing["lateness"], "realtime()": helped.timing["lateness"]}
    if isinstance(kernel, SectionTiming):
        rows["cyclictest"] = kernel
    show_timing(console, f"Wake-up lateness at {RATE_HZ:.0f} Hz, {seconds:.0f} s each", rows)
    console.print(f"default scheduling: {plain.one_line()}")
    console.print(f"realtime(): {helped.one_line()}; {help_given}")
    if isinstance(kernel, str):
        console.print(f"cyclictest: {kernel}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each real-time part [s]")
    seconds = parser.parse_args().seconds
    console = Console()
    with tempfile.TemporaryDirectory() as name:
        show_probing(console, Path(name))
        show_own_cost(console, Path(name))
        show_lateness(console, Path(name), seconds)


if __name__ == "__main__":
    main()
