"""How well the force limit is kept while probing: both simulated arms, over the range of objects.

Forces are the simulation's own, free of sensors. "late" is the highest force from 20 ms after the first
contact on; "hold" is the largest deviation over the last 0.3 s of the hold; "lost" counts ticks without
contact while loading and holding; "track" is the largest error of a joint.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from harness import arguments
from rich.console import Console
from rich.table import Column, Table

from palpate.control.loop.loop import run_loop
from palpate.control.loop.task import Phase, TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates, tick_stream
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import build_robot
from palpate.robot_io.types import Measurement
from palpate.runs.probing import TickRecords
from palpate.runs.robots import find_robot, shipped_robots
from palpate.sim_backend.scenario import load_scenario

RATE_HZ = 1000.0
SOFT = ((100.0, 200.0, 500.0, 1000.0, 2000.0), (0.15, 0.09, 0.06))  # stiffness [N/m], speeds [m/s]
STIFF = ((4000.0, 7100.0, 10_000.0), (0.05, 0.02, 0.01))
DAMPING_N_S_M = (0.0, 20.0, 100.0, 200.0)
LATE_S = 0.020
HEADER = (
    *("arm", "k [N/m]", "c [N s/m]", "mm/s", "peak [N]"),
    *("late [N]", "hold [N]", "lost", "tracking [mrad]"),
)


@dataclass(frozen=True)
class ForceRow:
    """Results of one run."""

    peak_n: float
    late_n: float
    hold_error_n: float
    lost_ticks: int
    tracking_rad: float


def probe(arm: str, stiffness_n_m: float, damping_n_s_m: float, plan: ProbingPlan) -> list[ForceRow]:
    """Probe one object at all speeds of the plan."""
    robot_file, clock, log = find_robot(arm), SimulatedClock(), TickRecords()
    true_n: list[float] = []
    task = ProbingTask.from_robot_file(robot_file, plan)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
    robot = build_robot(robot_file, DriverCatalog("palpate.sim_backend.drivers"), clock)
    law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness_n_m, "damping_n_s_m": damping_n_s_m}
    bus = robot.buses["world"]
    bus.use_scenario(load_scenario({"object": {"law": law}}))

    def keep_truth(_measurement: Measurement, _output: TaskOutput) -> Estimates:
        true_n.append(bus.world.truth().force_n)
        return NO_ESTIMATE

    with robot:
        run_loop(robot, guard, task, clock, log, rate_hz=RATE_HZ, observer=keep_truth).raise_for_trip()
    records = np.array(log.records, tick_stream(robot.joint_count).dtype)
    force_n = np.array(true_n)
    runs = range(len(plan.speeds_m_s))
    return [summary(records[records["run"] == run], force_n[records["run"] == run], plan) for run in runs]


def summary(records: np.ndarray, force_n: np.ndarray, plan: ProbingPlan) -> ForceRow:
    """What one run did to the force."""
    time_s, phase = records["time_s"], records["phase"]
    late = time_s >= time_s[force_n > 0.0][0] + LATE_S
    held = force_n[phase == Phase.HOLD][-300:]
    pressed = (phase == Phase.LOADING) | (phase == Phase.HOLD)
    return ForceRow(
        peak_n=force_n.max(),
        late_n=force_n[late].max(),
        hold_error_n=np.abs(held - plan.force_limit_n).max(),
        lost_ticks=int((force_n[pressed] <= 0.0).sum()),
        tracking_rad=np.abs(records["joint_position_rad"] - records["reference_position_rad"]).max(),
    )


def objects() -> Iterator[tuple[float, float, tuple[float, ...]]]:
    """Stiffness, damping, and the speeds at which it is probed."""
    for stiffnesses, speeds in (SOFT, STIFF):
        for stiffness in stiffnesses:
            for damping in DAMPING_N_S_M:
                yield stiffness, damping, speeds


def cells(arm: str, stiffness_n_m: float, damping_n_s_m: float, speed_m_s: float, row: ForceRow) -> list[str]:
    """A row of the table."""
    condition = [arm, f"{stiffness_n_m:.0f}", f"{damping_n_s_m:.0f}", f"{1e3 * speed_m_s:.0f}"]
    forces = [f"{row.peak_n:.2f}", f"{row.late_n:.2f}", f"{row.hold_error_n:.3f}"]
    return [*condition, *forces, f"{row.lost_ticks}", f"{1e3 * row.tracking_rad:.2f}"]


def main() -> None:
    """Measure and print."""
    parser = arguments(__doc__)
    parser.add_argument("--arm", choices=sorted(shipped_robots()), help="only this one")
    only = parser.parse_args().arm
    table = Table(*(Column(name, justify="right") for name in HEADER))
    rows: list[ForceRow] = []
    for arm in [only] if only else sorted(shipped_robots()):
        for stiffness, damping, speeds in objects():
            runs = probe(arm, stiffness, damping, ProbingPlan(speeds_m_s=speeds))
            rows += runs
            for speed, row in zip(speeds, runs, strict=True):
                table.add_row(*cells(arm, stiffness, damping, speed, row))
    console = Console()
    console.print(table)
    console.print(
        f"{len(rows)} runs, no trips; worst: late {max(row.late_n for row in rows):.2f} N, hold "
        f"{max(row.hold_error_n for row in rows):.3f} N, lost {max(row.lost_ticks for row in rows)}, "
        f"tracking {1e3 * max(row.tracking_rad for row in rows):.2f} mrad"
    )


if __name__ == "__main__":
    main()
