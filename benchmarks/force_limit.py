"""Measure how well probing keeps the force limit, for both simulated arms and a range of objects.

Forces are the true ones of the simulation, not sensor readings. "late" is the highest force from 20 ms after
the first contact on; "hold" is the largest deviation over the last 0.3 s of the hold; "lost" counts ticks
without contact while loading and holding; "track" is the largest error of a joint.
"""

from collections.abc import Iterator

import numpy as np
from harness import arguments, print_table

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


def probe(arm: str, stiffness_n_m: float, damping_n_s_m: float, plan: ProbingPlan) -> Iterator[np.ndarray]:
    """Probe one object at all speeds of the plan; see `summary` for the figures of a run."""
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
    for run in range(len(plan.speeds_m_s)):
        of_run = records["run"] == run
        yield summary(records[of_run], np.array(true_n)[of_run], plan.force_limit_n)


def summary(records: np.ndarray, force_n: np.ndarray, limit_n: float) -> np.ndarray:
    """Return a run's peak, late peak and deviation in the hold [N], lost ticks, and tracking error [mrad]."""
    time_s, phase = records["time_s"], records["phase"]
    late = time_s >= time_s[force_n > 0.0][0] + LATE_S
    hold_n = np.abs(force_n[phase == Phase.HOLD][-300:] - limit_n).max()
    lost = (force_n[np.isin(phase, (Phase.LOADING, Phase.HOLD))] <= 0.0).sum()
    track_rad = np.abs(records["joint_position_rad"] - records["reference_position_rad"]).max()
    return np.array([force_n.max(), force_n[late].max(), hold_n, lost, 1e3 * track_rad])


def objects() -> Iterator[tuple[float, float, tuple[float, ...]]]:
    """Yield stiffness, damping and probing speeds of each object."""
    for stiffnesses, speeds in (SOFT, STIFF):
        for stiffness in stiffnesses:
            for damping in DAMPING_N_S_M:
                yield stiffness, damping, speeds


def main() -> None:
    """Measure, and print the figures."""
    parser = arguments(__doc__)
    parser.add_argument("--arm", choices=sorted(shipped_robots()), help="only this one")
    only = parser.parse_args().arm
    rows: list[list[str]] = []
    results: list[np.ndarray] = []
    for arm in [only] if only else sorted(shipped_robots()):
        for k, c, speeds in objects():
            for speed, row in zip(speeds, probe(arm, k, c, ProbingPlan(speeds_m_s=speeds)), strict=True):
                results.append(row)
                cells = [f"{value:.{digits}f}" for value, digits in zip(row, (2, 2, 3, 0, 2), strict=True)]
                rows.append([arm, f"{k:.0f}", f"{c:.0f}", f"{1e3 * speed:.0f}", *cells])
    print_table("", HEADER, rows)
    _, late_n, hold_n, lost, track_mrad = np.max(results, axis=0)
    print(
        f"{len(rows)} runs, no trips; worst: late {late_n:.2f} N, hold {hold_n:.3f} N, lost {lost:.0f}, "
        f"tracking {track_mrad:.2f} mrad"
    )


if __name__ == "__main__":
    main()
