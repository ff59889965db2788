"""What a servo protocol must offer for the rest to be the same; the module of its codec is one."""

from collections.abc import Mapping
from typing import Any, Protocol

from palpate.robot_io.drivers.servo.stream import PacketStream


class Packet(Protocol):
    """What a servo answers."""

    @property
    def servo_id(self) -> int:
        """Who answers."""

    @property
    def data(self) -> bytes:
        """What it was asked for."""

    @property
    def alert(self) -> bool:
        """Whether the servo has an error of its own."""

    @property
    def refusal(self) -> str | None:
        """Why the instruction was refused, or None if it was not."""


class ServoDialect(Protocol):
    """Instructions as bytes, and what finds the answers to them."""

    def ping(self, servo_id: int) -> bytes:
        """Ask one servo who it is."""

    def ping_all(self) -> bytes:
        """Ask who is on the line; each servo answers after those with smaller ids."""

    def read(self, servo_id: int, address: int, size: int) -> bytes:
        """Read `size` bytes from `address` on."""

    def write(self, servo_id: int, address: int, data: bytes) -> bytes:
        """Write bytes from `address` on."""

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> bytes:
        """Write at the same address of several servos, each its own bytes; nobody answers."""

    def sync_write_block(self, address: int, size: int, block: bytes) -> bytes:
        """Do the same with a block of servo ids, each followed by the `size` bytes for that servo."""

    def packet_reader(self, request: bytes) -> PacketStream[Any]:
        """Make what finds the answers to a request, and not its echo."""
