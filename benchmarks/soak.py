"""Probe for hours through emulated buses with random faults, and check every value that is served as OK.

    python benchmarks/soak.py [--hours H] [--seed S] [--robot NAME]

Frames are dropped, late, duplicated, damaged or lose a byte, and devices restart. Each probing run uses a
robot of `robots/`, on simulated time. A position or force that is served as OK must equal the true value at
its time stamp. The guard may stop a run only after a fault; a run without a fault must finish. The memory of
the process must not grow after the first tenth of the time. Errors are printed at once; Ctrl-C ends with a
summary so far.
"""

import gc
import itertools
import sys
import time
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
import psutil
from harness import ROBOTS, arguments, resident_mb

from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import Outcome
from palpate.control.loop.task import TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import PalpateError
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Measurement, Status
from palpate.runs.probing import TickRecords
from palpate.sim_backend.emulators import Fault, FaultKind, Faults
from palpate.sim_backend.emulators.wiring import WiredArm, wire_up
from palpate.sim_backend.scenario import load_scenario

SPEEDS_M_S = {"so101": 0.03}  # speed that its servos can follow; the others probe at 0.1 m/s
KINDS = tuple(FaultKind[name] for name in ("DROP", "DELAY", "DUPLICATE", "CORRUPT", "LOSE", "REBOOT"))
ON_BYTES_ONLY = {FaultKind.LOSE}  # no CAN frame survives it
FAULTY = 0.7  # share of the runs with faults
LATEST_S = 8.0  # latest fault after the start of a run
TOLERANCE_RAD, TOLERANCE_N = 0.02, 2.0  # 1 % of the sensor's capacity, and what it moves meanwhile
SETTLED_S = 0.05  # after the start; the true state is not yet recorded at the times of the first samples


class TruthLog:
    """Recent true states, with which samples are compared."""

    def __init__(self, arm: WiredArm) -> None:
        self._plant = arm.plant
        # Times [s], joint positions [rad] and force [N], newest first.
        self._states: deque[tuple[float, list[float]]] = deque(maxlen=400)
        self.wrong: list[str] = []
        self.checked = 0

    def check(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """Record the true state, and compare values served as OK with past states; return no estimates."""
        truth = self._plant.world.truth()
        self._states.appendleft((truth.time_s, [*truth.joint_position_rad.tolist(), self._plant.force[0]]))
        if len(self._states) < 3 or truth.time_s - self._states[-1][0] < SETTLED_S:
            return NO_ESTIMATE
        if measurement.encoder_status is Status.OK:
            true = self._at(measurement.encoder_at_s)[:-1]
            self._compare("position", measurement.joint_position_rad.tolist(), true, TOLERANCE_RAD)
        if measurement.force_status is Status.OK:
            true = self._at(measurement.force_at_s)[-1:]
            self._compare("force", [measurement.force_n], true, TOLERANCE_N)
        return NO_ESTIMATE

    def _at(self, time_s: float) -> list[float]:
        """Interpolate the true state, whose last item is the force; constant outside the known times."""
        later_s, later = self._states[0]
        for earlier_s, earlier in self._states:
            if earlier_s <= time_s:
                share = (time_s - earlier_s) / (later_s - earlier_s) if later_s > earlier_s else 0.0
                return [a + min(share, 1.0) * (b - a) for a, b in zip(earlier, later, strict=True)]
            later_s, later = earlier_s, earlier
        return later

    def _compare(self, name: str, served: list[float], true: list[float], tolerance: float) -> None:
        self.checked += 1
        off = max(abs(value - known) for value, known in zip(served, true, strict=True))
        if not off < tolerance:
            self.wrong.append(f"{name} at {self._states[0][0]:.3f} s is off by {off:.3g}")


@dataclass
class Tally:
    """Results of all runs."""

    simulated_s: float = 0.0
    runs: Counter[str] = field(default_factory=Counter)
    injected: Counter[str] = field(default_factory=Counter)
    checked: int = 0
    trouble: list[str] = field(default_factory=list)


def faults_of(bus_driver: str, rng: np.random.Generator) -> list[Fault]:
    """Draw up to three faults of one bus at random times."""
    on_can = "can" in bus_driver
    kinds = [kind for kind in KINDS if not (on_can and kind in ON_BYTES_ONLY)]
    faults = []
    for _ in range(int(rng.integers(0, 4))):
        kind = kinds[int(rng.integers(len(kinds)))]
        details = {"from_s": float(rng.uniform(0.0, LATEST_S)), "times": int(rng.integers(1, 30))}
        if kind in (FaultKind.DELAY, FaultKind.REBOOT):
            details["delay_s"] = float(10.0 ** rng.uniform(-3.0, -0.5))
        faults.append(Fault(kind=kind, probability=float(rng.uniform(0.02, 1.0)), **details))
    return faults


def probe(name: str, rng: np.random.Generator, tally: Tally) -> None:
    """Probe once with a robot."""
    robot_file, clock = load_robot_file(ROBOTS / f"{name}.yaml"), SimulatedClock()
    seed = int(rng.integers(2**32))
    faulty = rng.random() < FAULTY
    buses = robot_file.buses.items()
    planned = {bus: faults_of(section.driver, rng) if faulty else [] for bus, section in buses}
    faults = {bus: Faults(some, seed=seed, start_s=clock.now_s()) for bus, some in planned.items()}
    arm = wire_up(robot_file, load_scenario("default"), clock, faults)
    truth = TruthLog(arm)
    plan = ProbingPlan(speeds_m_s=(SPEEDS_M_S.get(name, 0.1),), hold_s=0.5)
    begun_s, cause = clock.now_s(), ""
    try:
        with build_robot(arm.robot_file, DriverCatalog(), clock) as robot:
            guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
            task = ProbingTask.from_robot_file(robot_file, plan)
            rate = {"rate_hz": robot_file.control_rate_hz, "observer": truth.check}
            result = run_loop(robot, guard, task, clock, TickRecords(), **rate)
        outcome, cause = result.outcome.value, result.cause
        if result.outcome is Outcome.STOPPED and "interrupted by the user" in result.cause:
            raise KeyboardInterrupt
        if result.observer_error:
            tally.trouble.append(f"{name}, seed {seed}: {result.observer_error}")
    except PalpateError as error:
        outcome, cause = "refused", str(error)
    finally:
        arm.emulator.close()
    every = itertools.chain(*planned.values())
    injected = [fault.kind.value for fault in every if begun_s + fault.from_s < clock.now_s()]
    tally.simulated_s += clock.now_s() - begun_s
    tally.runs[outcome] += 1
    tally.injected.update(injected)
    tally.checked += truth.checked
    tally.trouble += [
        f"{name}, seed {seed}: {wrong}, after {', '.join(injected)}" for wrong in truth.wrong[:1]
    ]
    if outcome != Outcome.FINISHED.value and not injected:
        tally.trouble.append(f"{name}, seed {seed}: {outcome} without a fault: {cause}")


def main() -> None:
    """Probe for the requested time."""
    known = sorted(path.stem for path in ROBOTS.glob("*.yaml") if ".dh" not in path.name)
    parser = arguments(__doc__)
    parser.add_argument("--hours", type=float, default=8.0, help="of simulated time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", choices=known, help="this one only")
    options = parser.parse_args()
    names = itertools.cycle([options.robot] if options.robot else known)
    rng, tally = np.random.default_rng(options.seed), Tally()
    limit_s, memory_mb, started_s = 3600.0 * options.hours, [], time.perf_counter()
    with suppress(KeyboardInterrupt):  # the summary is then of the time so far
        while tally.simulated_s < limit_s:
            known_trouble = len(tally.trouble)
            probe(next(names), rng, tally)
            print("".join(f"{line}\n" for line in tally.trouble[known_trouble:]), end="", flush=True)
            if tally.simulated_s > len(memory_mb) * limit_s / 20.0:
                gc.collect()
                memory_mb.append(resident_mb(psutil.Process()))
                hours = tally.simulated_s / 3600.0
                print(f"{hours:.2f} h, {dict(tally.runs)}, {memory_mb[-1]:.0f} MB", flush=True)
    steady = memory_mb[2:] or memory_mb or [np.nan]
    print(
        f"{tally.simulated_s / 3600:.2f} h in {tally.runs.total()} runs: {dict(tally.runs)}; faults begun: "
        f"{dict(tally.injected)}; {tally.checked} values served as OK were checked; "
        f"{tally.simulated_s / (time.perf_counter() - started_s):.1f} times real time"
    )
    growth = f"{steady[0]:.1f} to {steady[-1]:.1f} MB ({steady[-1] / steady[0] - 1:+.1%})"
    print(f"memory: {growth} after the first tenth")
    print(f"{len(tally.trouble)} wrong values, or stops without a fault before them")
    sys.exit(bool(tally.trouble))


if __name__ == "__main__":
    main()
