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
from collections.abc import Callable
from contextlib import closing
from time import perf_counter
from typing import Any

import numpy as np
from harness import ROBOTS, print_table

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.drivers.servo.bus import ServoBus
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.emulators.wiring import wire_up
from palpate.sim_backend.scenario import load_scenario

KINDS = {"dynamixel": "dynamixel_3dof.yaml", "feetech": "so101.yaml"}
TICK_S, WARM_UP, ROUNDS = 5e-3, 20, 20


class ReplayedPort:
    """Serves the answer of one tick of a bus again and again.

    Args:
        bus: active, on emulated servos in lock-step with `clock`.
        clock: simulated.
    """

    def __init__(self, bus: ServoBus[Any], clock: SimulatedClock) -> None:
        self._bus, self._clock, self._zero, self.spent_s = bus, clock, np.zeros(bus.joint_count), 0.0
        port: Any = bus._port
        own, self._send, receive = (port._fd, port._poll), port.write, port.read
        sent: list[bytes] = []
        received: list[bytes] = []
        port.write = lambda data: (sent.append(data), self._send(data))[1]
        port.read = lambda: received.append(receive()) or received[-1]
        for _ in range(3):
            del sent[:], received[:]
            self.tick()
        self._request, self._goals = sent
        self._answer = b"".join(received)
        self._layout = struct.Struct(f"<{len(self._answer)}B")
        self._ends = socket.socketpair()
        for end in self._ends:
            end.setblocking(False)
        self._fd, self._far_fd = (end.fileno() for end in self._ends)
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        port._fd, port._poll, port.read, port.write = self._fd, poll, receive, self.write
        self._restore = lambda: vars(port).update(_fd=own[0], _poll=own[1], write=self._send)

    def write(self, data: bytes) -> None:
        """Send bytes; a request is answered at once, and this time is not counted."""
        self._send(data)
        begun_s = perf_counter()
        os.read(self._far_fd, 4096)
        if data == self._request:
            os.write(self._far_fd, self._answer)
        self.spent_s += perf_counter() - begun_s

    def tick(self) -> None:
        """Poll, stage and flush, as the robot does in each tick."""
        self._bus.poll(self._clock.now_s() + TICK_S)
        self._bus.stage(self._zero)
        self._bus.flush(self._clock.now_s() + TICK_S)

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
        self._restore()
        for end in self._ends:
            end.close()


def main() -> None:
    """Measure each kind, both loops in turn, and print one line for each."""
    ticks = (int(sys.argv[1]) if len(sys.argv) > 1 else 5000) // ROUNDS
    rows = []
    for kind, file in KINDS.items():
        clock = SimulatedClock()
        arm = wire_up(load_robot_file(ROBOTS / file), load_scenario("default"), clock)
        with closing(arm.emulator), build_robot(arm.robot_file, DriverCatalog(), clock) as robot:
            robot.activate()
            bus = next(bus for bus in robot.buses.values() if isinstance(bus, ServoBus))
            with closing(ReplayedPort(bus, clock)) as port:
                rounds = [
                    (port.measure(ticks, port.bare_tick), port.measure(ticks, port.tick))
                    for _ in range(ROUNDS)
                ]
        bare, ours = np.percentile(np.concatenate(rounds, axis=1), 20, axis=1)
        rows.append((kind, f"{ours:.1f}", f"{bare:.1f}", f"{ours / bare:.1f}"))
    print_table("us, 20th percentiles", ("servos", "palpate", "bare", "ratio"), rows)


if __name__ == "__main__":
    main()
