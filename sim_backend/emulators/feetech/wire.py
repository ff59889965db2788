"""The servo's side of Feetech's protocol: bytes to instructions, answers to bytes.

Written from Feetech's protocol manual for the SMS/STS series; it shares no code with the driver.
"""

from collections.abc import Iterator
from dataclasses import dataclass

BROADCAST = 0xFE


@dataclass(frozen=True)
class Instruction:
    """An instruction packet as a servo has understood it."""

    target: int  # id of the servo, or `BROADCAST`
    code: int  # what to do
    parameters: bytes  # with what
    wire_bytes: int  # bytes that it took on the wire


class Receiver:
    """Picks instructions out of what comes over the wire; servos say nothing to damaged ones."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def take(self, data: bytes) -> Iterator[Instruction]:
        """The instructions that are complete with `data`."""
        pending = self._pending
        pending += data
        while len(pending) >= 6:
            if pending[0] != 0xFF or pending[1] != 0xFF or pending[3] < 2:
                del pending[0]
                continue
            total = pending[3] + 4
            if len(pending) < total:
                return
            if inverted_sum(pending[2 : total - 1]) != pending[total - 1]:
                del pending[0]
                continue
            packet = bytes(pending[:total])
            del pending[:total]
            yield Instruction(packet[2], packet[4], packet[5:-1], total)


def inverted_sum(content: bytes | bytearray) -> int:
    """The checksum of what is between header and itself."""
    total = 0
    for byte in content:
        total = (total + byte) % 256
    return 255 - total


def status(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """A status packet."""
    content = bytes((servo_id, len(data) + 2, error)) + data
    return b"\xff\xff" + content + bytes((inverted_sum(content),))
