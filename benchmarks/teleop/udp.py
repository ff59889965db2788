"""The same link in real time: UDP on loopback, through a relay process that delays and loses packets.

To check that the link in one process is like a real one. Netem would do what the relay does, where the kernel
has it.
"""

import multiprocessing
import select
import socket
import struct
import time
from multiprocessing.synchronize import Event
from typing import Self

import numpy as np

from benchmarks.teleop.link import Arrived, Line, LinkFaults
from control.teleop.couplings.channel import Packet

HOST = "127.0.0.1"
LONGEST_S = 600.0  # the relay ends by itself
_NUMBER = struct.Struct("<I")


class UdpLink:
    """Both ways of a link (see `run.Lines`); a step waits for its time. Use as a context manager."""

    def __init__(self, faults: LinkFaults, seed: int = 0) -> None:
        self._ends = (_End(), _End())  # leader, follower
        at_relay = [_bound(), _bound()]  # what the leader sends to, and what the follower sends to
        for end, own in zip(self._ends, at_relay, strict=True):
            end.relay = own.getsockname()
        self._stop = multiprocessing.get_context("fork").Event()
        ends = [end.socket.getsockname() for end in self._ends]
        self._relay = multiprocessing.get_context("fork").Process(
            target=relay, args=(at_relay, ends[::-1], faults, seed, self._stop), daemon=True
        )

    def __enter__(self) -> Self:
        self._relay.start()
        self._start_s = time.monotonic()
        return self

    def __exit__(self, *_failure: object) -> None:
        self._stop.set()
        self._relay.join(2.0)

    def exchange(self, time_s: float, to_follower: Packet, to_leader: Packet) -> None:
        """Send one packet each way."""
        for end, packet in zip(self._ends, (to_follower, to_leader), strict=True):
            end.send(packet)

    def arrived(self, time_s: float) -> tuple[Arrived, Arrived]:
        """Wait until `time_s` [s] after the start; then what has come to leader and follower."""
        wait_s = self._start_s + time_s - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        leader, follower = self._ends
        return leader.arrived(), follower.arrived()

    @property
    def ages(self) -> np.ndarray:
        """How many steps old the newest packet was at the leader, at each step since the first came."""
        return np.array(self._ends[0].ages)


class _End:
    """One machine: sends to the relay, and hands out what comes."""

    def __init__(self) -> None:
        self.socket = _bound()
        self.relay: tuple[str, int] = (HOST, 0)
        self.ages: list[int] = []
        self._sent, self._newest = 0, -1

    def send(self, packet: Packet) -> None:
        self.socket.sendto(_NUMBER.pack(self._sent) + np.array(packet).tobytes(), self.relay)
        self._sent += 1

    def arrived(self) -> Arrived:
        arrived = []
        while (message := _received(self.socket)) is not None:
            (number,) = _NUMBER.unpack_from(message)
            packet = tuple(np.frombuffer(message, np.float64, offset=_NUMBER.size).tolist())
            arrived.append((number, packet))
            self._newest = max(self._newest, number)
        if self._newest >= 0:
            self.ages.append(self._sent - self._newest)  # both ends send at the same rate
        return arrived


def relay(
    sockets: list[socket.socket], targets: list[tuple[str, int]], faults: LinkFaults, seed: int, stop: Event
) -> None:
    """Pass what comes at each socket on to its target, late or not at all."""
    line = Line[tuple[int, bytes]](faults, np.random.default_rng(seed))
    end_s = time.monotonic() + LONGEST_S
    while not stop.is_set() and time.monotonic() < end_s:
        select.select(sockets, [], [], min(0.05, max(0.0, line.next_s - time.monotonic())))
        for way, come in enumerate(sockets):
            while (message := _received(come)) is not None:
                line.send((way, message), time.monotonic())
        for _, (way, message) in line.arrived(time.monotonic()):
            sockets[way].sendto(message, targets[way])


def _bound() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((HOST, 0))
    made.setblocking(False)
    return made


def _received(end: socket.socket) -> bytes | None:
    try:
        return end.recv(4096)
    except BlockingIOError:
        return None
