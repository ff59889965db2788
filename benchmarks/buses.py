"""What drivers of joint buses cost beside a loop that only moves the same bytes or frames.

Run: python benchmarks/buses.py [ticks, default 5000]

The devices are emulated in lock-step, so that their time is not in the figures. Each driver and its bare loop
run by turns, so that other load meets both alike.

A servo bus polls, decodes, checks, stages and flushes. An emulated arm answers one tick of it; a socket in
place of the port then serves this answer again in every tick. The bare loop writes the request, waits for the
answer, unpacks it, and writes the goals; it checks nothing. The 20th percentile of the ticks counts.

Of the motors on a CAN bus, three of each kind, palpate's whole robot with its force sensor is measured. The
bare loop receives and sends the same frames through python-can. The median of the ticks counts.
"""

import os
import select
import socket
import struct
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import can
import numpy as np
from harness import ROBOTS, print_table

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.drivers.servo.bus import ServoBus
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Command
from palpate.sim_backend.emulators.wiring import wire_up
from palpate.sim_backend.scenario import load_scenario

SERVOS = {"dynamixel": "dynamixel_3dof.yaml", "feetech": "so101.yaml"}
MOTORS = ("odrive", "cubemars", "damiao", "robstride", "moteus")
WARM_UP, ROUNDS = 20, 20
Ways = tuple[Callable[[int], list[float]], Callable[[int], list[float]]]  # times [us] of ticks: bare, ours


@contextmanager
def emulated_robot(file: Path) -> Iterator[tuple[Robot, SimulatedClock]]:
    """Yield an active robot whose devices are emulated in lock-step with a clock, which takes no time."""
    clock = SimulatedClock()
    arm = wire_up(load_robot_file(file), load_scenario("default"), clock)
    try:
        with build_robot(arm.robot_file, DriverCatalog(), clock) as robot:
            robot.activate()
            yield robot, clock
    finally:
        arm.emulator.close()


class ReplayedPort:
    """Serves the answer of one tick of a bus again and again.

    Args:
        bus: active, on emulated servos in lock-step with `clock`.
        clock: simulated.
    """

    tick_s = 5e-3

    def __init__(self, bus: ServoBus[Any], clock: SimulatedClock) -> None:
        self._bus, self._clock = bus, clock
        self._port, self._zero, self._spent_s = bus._port, np.zeros(bus.joint_count), 0.0
        sent: list[bytes] = []
        received: list[bytes] = []
        write, read = self._port.write, self._port.read
        self._port.write = lambda data: (sent.append(data), write(data))[1]  # type: ignore[method-assign,func-returns-value]
        self._port.read = lambda: received.append(read()) or received[-1]  # type: ignore[method-assign,func-returns-value]
        for _ in range(3):
            del sent[:], received[:]
            self.tick()
        self._port.read = read  # type: ignore[method-assign]
        self._request, self._goals = sent
        self._answer = b"".join(received)
        self._layout = struct.Struct(f"<{len(self._answer)}B")
        self._write, self._ends = write, socket.socketpair()
        for end in self._ends:
            end.setblocking(False)
        self._own_fd, self._fd, self._far_fd = self._port._fd, *(end.fileno() for end in self._ends)
        self._own_poll, poll = self._port._poll, select.poll()
        poll.register(self._fd, select.POLLIN)
        self._port._fd, self._port._poll = self._fd, poll
        self._port.write = self.write  # type: ignore[method-assign]

    def write(self, data: bytes) -> None:
        """Send bytes; a request is answered at once, in time that is not counted."""
        self._write(data)
        begun_s = perf_counter()
        os.read(self._far_fd, 4096)
        if data == self._request:
            os.write(self._far_fd, self._answer)
        self._spent_s += perf_counter() - begun_s

    def tick(self) -> None:
        """Poll, stage and flush, as the robot does in each tick."""
        self._bus.poll(self._clock.now_s() + self.tick_s)
        self._bus.stage(self._zero)
        self._bus.flush(self._clock.now_s() + self.tick_s)

    def bare_tick(self) -> None:
        """Write a request, read the answer, unpack it, write the goals."""
        self.write(self._request)
        select.select([self._fd], [], [], 1.0)
        self._layout.unpack(os.read(self._fd, 4096))
        self.write(self._goals)

    def measure(self, tick: Callable[[], object], ticks: int) -> list[float]:
        """Durations of ticks, without what answers them [us]."""
        times_us = []
        for _ in range(WARM_UP + ticks):
            self._spent_s, begun_s = 0.0, perf_counter()
            tick()
            times_us.append(1e6 * (perf_counter() - begun_s - self._spent_s))
        return times_us[WARM_UP:]

    def close(self) -> None:
        """Give the emulated servos their port back."""
        self._port._fd, self._port._poll = self._own_fd, self._own_poll
        self._port.write = self._write  # type: ignore[method-assign]
        for end in self._ends:
            end.close()


def motor_ways(robot: Robot, clock: SimulatedClock, tick_s: float = 1e-3) -> Ways:
    """How to time ticks of a robot on a CAN bus, and of its frames alone."""
    bus, zero = robot.buses["motors"].line._bus, Command(np.zeros(3))  # type: ignore[attr-defined]

    def whole() -> None:
        robot.read(clock.now_s() + tick_s)
        robot.write(zero, clock.now_s() + tick_s)

    def bare(frames: list[can.Message]) -> None:
        while bus.recv(timeout=0.0) is not None:
            pass
        for frame in frames:
            bus.send(frame, timeout=0.0)

    def measure(tick: Callable[[], None], ticks: int) -> list[float]:
        times_us = []
        for _ in range(WARM_UP + ticks):
            clock.sleep_until(clock.now_s() + tick_s)
            begun_s = thread_time()
            tick()
            times_us.append(1e6 * (thread_time() - begun_s))
        return times_us[WARM_UP:]

    def measure_bare(ticks: int) -> list[float]:
        frames: list[can.Message] = []
        send, bus.send = bus.send, lambda message, timeout=None: frames.append(message)
        whole()
        bus.send = send
        return measure(partial(bare, frames), ticks)

    return measure_bare, partial(measure, whole)


def compare(title: str, loops: Mapping[str, Ways], ticks: int, percentile: float) -> None:
    """Measure all kinds in turn, several times, and print a line each."""
    times: dict[tuple[str, int], list[float]] = defaultdict(list)
    for _ in range(ROUNDS):
        for kind, ways in loops.items():
            for number, measure in enumerate(ways):
                times[kind, number] += measure(ticks // ROUNDS)
    rows = []
    for kind in loops:
        bare, ours = (np.percentile(times[kind, number], percentile) for number in (0, 1))
        rows.append((kind, f"{ours:.1f}", f"{bare:.1f}", f"{ours / bare:.1f}"))
    print_table(title, ("", "palpate", "bare", "ratio"), rows)


def main() -> None:
    """Compare all drivers with their bare loops."""
    ticks = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
    servos: dict[str, Ways] = {}
    motors: dict[str, Ways] = {}
    with ExitStack() as stack:
        for kind, file in SERVOS.items():
            robot, clock = stack.enter_context(emulated_robot(ROBOTS / file))
            bus = next(bus for bus in robot.buses.values() if isinstance(bus, ServoBus))
            port = stack.enter_context(closing(ReplayedPort(bus, clock)))
            servos[kind] = partial(port.measure, port.bare_tick), partial(port.measure, port.tick)
        for kind in MOTORS:
            motors[kind] = motor_ways(*stack.enter_context(emulated_robot(ROBOTS / f"{kind}_3dof.yaml")))
        compare("servos: us, 20th percentiles", servos, ticks, 20.0)
        compare("CAN motors: us, medians", motors, ticks, 50.0)


if __name__ == "__main__":
    main()
