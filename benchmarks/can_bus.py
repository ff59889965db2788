"""What the drivers of motors on a CAN bus add to the time that python-can itself takes.

Run: python benchmarks/can_bus.py [ticks, default 3000]

Three emulated motors of each kind on a virtual bus in lock-step, so that the emulators' time is not in it. In
each tick all joints are read and commanded, in two ways: palpate's whole robot with its force sensor, and the
same frames received and sent through python-can and nothing else. "Added" is the difference of the medians.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import can
import numpy as np

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Command
from palpate.sim_backend.emulators.wiring import wire_up
from palpate.sim_backend.scenario import load_scenario

ROBOTS = Path(__file__).parents[1] / "robots"
KINDS = ("odrive", "cubemars", "damiao", "robstride", "moteus")
TICK_S, WARM_UP, ROUNDS = 1e-3, 20, 10
ZERO = Command(np.zeros(3))


def measure(clock: SimulatedClock, ticks: int, tick: Callable[[], object]) -> list[float]:
    """Time of this thread in each tick [us], whatever else the machine does."""
    times_s = []
    for _ in range(WARM_UP + ticks):
        clock.sleep_until(clock.now_s() + TICK_S)
        start_s = time.thread_time()
        tick()
        times_s.append(1e6 * (time.thread_time() - start_s))
    return times_s[WARM_UP:]


def whole(robot: Robot, clock: SimulatedClock) -> Callable[[], object]:
    """Read and command as the control loop does."""

    def tick() -> None:
        robot.read(clock.now_s() + TICK_S)
        robot.write(ZERO, clock.now_s() + TICK_S)

    return tick


def bare(bus: can.BusABC, commands: list[can.Message]) -> Callable[[], object]:
    """The same frames with nothing around them."""

    def tick() -> None:
        while bus.recv(timeout=0.0) is not None:
            pass
        for command in commands:
            bus.send(command, timeout=0.0)

    return tick


def commands_of(robot: Robot, bus: can.BusABC, clock: SimulatedClock) -> list[can.Message]:
    """The frames that a tick sends."""
    sent: list[can.Message] = []
    send, bus.send = bus.send, lambda message, timeout=None: sent.append(message)
    whole(robot, clock)()
    bus.send = send
    return sent


def main() -> None:
    """Measure all kinds in turn, several times, and print a line each."""
    ticks = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    times: dict[tuple[str, bool], list[float]] = defaultdict(list)
    with ExitStack() as stack:
        benches = {}
        for kind in KINDS:
            clock = SimulatedClock()
            arm = wire_up(load_robot_file(ROBOTS / f"{kind}_3dof.yaml"), load_scenario("default"), clock)
            stack.callback(arm.emulator.close)
            robot = stack.enter_context(build_robot(arm.robot_file, DriverCatalog(), clock))
            robot.activate()
            benches[kind] = (clock, robot)
        for _ in range(ROUNDS):
            for kind, (clock, robot) in benches.items():
                bus = robot.buses["motors"].line._bus  # type: ignore[attr-defined]
                commands = commands_of(robot, bus, clock)
                times[kind, False] += measure(clock, ticks // ROUNDS, bare(bus, commands))
                times[kind, True] += measure(clock, ticks // ROUNDS, whole(robot, clock))
    print(f"{'motors':<12}{'palpate':>10}{'python-can':>12}{'added':>8} us, medians")
    for kind in KINDS:
        ours, theirs = np.median(times[kind, True]), np.median(times[kind, False])
        print(f"{kind:<12}{ours:>10.0f}{theirs:>12.0f}{ours - theirs:>8.0f}")


if __name__ == "__main__":
    main()
