"""Measure the time that the CAN motor drivers add to that of python-can itself.

Run: python benchmarks/can_bus.py [ticks, default 3000]

Three emulated motors of each kind share a virtual bus in lock-step, so that the emulators' time is not
counted. In each tick all joints are read and commanded in two ways: by palpate's whole robot with its force
sensor, and by receiving and sending the same frames through python-can alone. "Added" is the difference of
the medians.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack

import can
import numpy as np
from harness import ROBOTS, print_table
from servo_bus import emulated_robot

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.robot import Robot
from palpate.robot_io.types import Command

KINDS = ("odrive", "cubemars", "damiao", "robstride", "moteus")
TICK_S, WARM_UP, ROUNDS = 1e-3, 20, 10
ZERO = Command(np.zeros(3))


def measure(clock: SimulatedClock, ticks: int, tick: Callable[[], object]) -> list[float]:
    """Return the processor time of this thread in each tick [us]."""
    times_s = []
    for _ in range(WARM_UP + ticks):
        clock.sleep_until(clock.now_s() + TICK_S)
        start_s = time.thread_time()
        tick()
        times_s.append(1e6 * (time.thread_time() - start_s))
    return times_s[WARM_UP:]


def whole(robot: Robot, clock: SimulatedClock) -> None:
    """Read and command as the control loop does."""
    robot.read(clock.now_s() + TICK_S)
    robot.write(ZERO, clock.now_s() + TICK_S)


def bare(bus: can.BusABC, commands: list[can.Message]) -> None:
    """Receive and send the same frames through python-can alone."""
    while bus.recv(timeout=0.0) is not None:
        pass
    for command in commands:
        bus.send(command, timeout=0.0)


def commands_of(robot: Robot, bus: can.BusABC, clock: SimulatedClock) -> list[can.Message]:
    """Return the frames that a tick sends."""
    sent: list[can.Message] = []
    send, bus.send = bus.send, lambda message, timeout=None: sent.append(message)
    whole(robot, clock)
    bus.send = send
    return sent


def main() -> None:
    """Measure all kinds in turn, several times, and print one line for each."""
    ticks = (int(sys.argv[1]) if len(sys.argv) > 1 else 3000) // ROUNDS
    times: dict[tuple[str, bool], list[float]] = defaultdict(list)
    with ExitStack() as stack:
        arms = {kind: stack.enter_context(emulated_robot(ROBOTS / f"{kind}_3dof.yaml")) for kind in KINDS}
        for _ in range(ROUNDS):
            for kind, (robot, clock) in arms.items():
                bus = robot.buses["motors"].line._bus  # type: ignore[attr-defined]
                commands = commands_of(robot, bus, clock)
                times[kind, False] += measure(clock, ticks, lambda bus=bus, sent=commands: bare(bus, sent))
                times[kind, True] += measure(clock, ticks, lambda arm=robot, at=clock: whole(arm, at))
    medians = [(kind, *(np.median(times[kind, is_ours]) for is_ours in (True, False))) for kind in KINDS]
    rows = [(kind, f"{ours:.0f}", f"{bare:.0f}", f"{ours - bare:.0f}") for kind, ours, bare in medians]
    print_table("us, medians", ("motors", "palpate", "python-can", "added"), rows)


if __name__ == "__main__":
    main()
