"""Compare the time of the serial servo drivers with that of a loop that only moves the same bytes.

Run: python benchmarks/servo_bus.py [ticks, default 5000]

An emulated arm answers one tick of each driver. A socket in place of the port then serves this answer again
in every tick, so that the emulator's time is not counted. The bare loop writes the request, waits for the
answer, unpacks it, and writes the goals; it checks nothing. The bus polls, decodes, checks, stages and
flushes. Both run in turn, and the 20th percentile of the ticks counts, so that other load affects both alike.
"""

import os
import select
import socket
import struct
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from harness import ROBOTS, print_table

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.drivers.servo.bus import ServoBus
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.emulators.wiring import wire_up
from palpate.sim_backend.scenario import load_scenario

KINDS = {"dynamixel": "dynamixel_3dof.yaml", "feetech": "so101.yaml"}
TICK_S, WARM_UP, ROUNDS = 5e-3, 20, 20


@contextmanager
def emulated_robot(file: Path) -> Iterator[tuple[Robot, SimulatedClock]]:
    """Yield an active robot whose devices are emulated in lock-step with a clock that takes no time."""
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

    def __init__(self, bus: ServoBus[Any], clock: SimulatedClock) -> None:
        self._port, self.zero, self.spent_s = bus._port, np.zeros(bus.joint_count), 0.0
        sent: list[bytes] = []
        received: list[bytes] = []
        write, read = self._port.write, self._port.read
        self._port.write = lambda data: (sent.append(data), write(data))[1]  # type: ignore[method-assign,func-returns-value]
        self._port.read = lambda: received.append(read()) or received[-1]  # type: ignore[method-assign,func-returns-value]
        for _ in range(3):
            del sent[:], received[:]
            self.tick(bus, clock)
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
        """Send bytes; a request is answered at once, and this time is not counted."""
        self._write(data)
        begun_s = perf_counter()
        os.read(self._far_fd, 4096)
        if data == self._request:
            os.write(self._far_fd, self._answer)
        self.spent_s += perf_counter() - begun_s

    def tick(self, bus: ServoBus[Any], clock: SimulatedClock) -> None:
        """Poll, stage and flush, as the robot does in each tick."""
        bus.poll(clock.now_s() + TICK_S)
        bus.stage(self.zero)
        bus.flush(clock.now_s() + TICK_S)

    def bare_tick(self) -> None:
        """Write a request, read the answer, unpack it, write the goals."""
        self.write(self._request)
        select.select([self._fd], [], [], 1.0)
        self._layout.unpack(os.read(self._fd, 4096))
        self.write(self._goals)

    def measure(self, ticks: int, tick: Callable[[], object]) -> list[float]:
        """Return the durations of ticks without the time of the answers [us]."""
        times_us = []
        for _ in range(WARM_UP + ticks):
            self.spent_s, begun_s = 0.0, perf_counter()
            tick()
            times_us.append(1e6 * (perf_counter() - begun_s - self.spent_s))
        return times_us[WARM_UP:]

    def close(self) -> None:
        """Give the emulated servos their port back."""
        self._port._fd, self._port._poll = self._own_fd, self._own_poll
        self._port.write = self._write  # type: ignore[method-assign]
        for end in self._ends:
            end.close()


def main() -> None:
    """Measure all kinds in turn, several times, and print one line for each."""
    ticks = (int(sys.argv[1]) if len(sys.argv) > 1 else 5000) // ROUNDS
    times: dict[tuple[str, bool], list[float]] = defaultdict(list)
    with ExitStack() as stack:
        loops = {}
        for kind, file in KINDS.items():
            robot, clock = stack.enter_context(emulated_robot(ROBOTS / file))
            bus = next(bus for bus in robot.buses.values() if isinstance(bus, ServoBus))
            port = stack.enter_context(closing(ReplayedPort(bus, clock)))
            loops[kind] = (port, lambda port=port, bus=bus, clock=clock: port.tick(bus, clock))
        for _ in range(ROUNDS):
            for kind, (port, tick) in loops.items():
                times[kind, False] += port.measure(ticks, port.bare_tick)
                times[kind, True] += port.measure(ticks, tick)
    rows = []
    for kind in KINDS:
        ours, bare = (np.percentile(times[kind, is_ours], 20) for is_ours in (True, False))
        rows.append((kind, f"{ours:.1f}", f"{bare:.1f}", f"{ours / bare:.1f}"))
    print_table("us, 20th percentiles", ("servos", "palpate", "bare", "ratio"), rows)


if __name__ == "__main__":
    main()
