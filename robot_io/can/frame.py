"""A CAN frame as the codecs see it, free of any adapter."""

from dataclasses import dataclass

from robot_io.errors import ProtocolError


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One classic CAN 2.0 frame.

    Attributes:
        can_id: arbitration id, 11 bits, or 29 when `extended`.
        data: 0 to 8 bytes.
        extended: whether the id has 29 bits.
        remote: whether it asks for a frame of this id instead of being one.
    """

    can_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False


def expect_length(frame: CanFrame, what: str, *lengths: int) -> None:
    """Check the number of data bytes.

    Raises:
        ProtocolError: it is none of `lengths`.
    """
    if len(frame.data) not in lengths:
        valid = " or ".join(map(str, lengths))
        raise ProtocolError(f"{what} has {len(frame.data)} bytes, expected {valid}")
