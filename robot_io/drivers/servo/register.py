"""One value in a servo's memory, as data. Little-endian; signs as its maker writes them."""

from dataclasses import dataclass

from palpate.robot_io.errors import ProtocolError


@dataclass(frozen=True, slots=True)
class Register:
    """One value of a servo."""

    name: str  # as in the manual
    address: int  # of its first byte
    size: int  # bytes
    signed: bool = False  # whether it can be negative, in two's complement
    sign_bit: int | None = None  # the bit that says negative where the others are the magnitude

    def encode(self, value: int) -> bytes:
        """The bytes of a value. ProtocolError: it does not fit.

        Args:
            value: number to write.
        """
        number = value
        if self.sign_bit is not None:
            number = abs(value) | (value < 0) << self.sign_bit
            if abs(value) >> self.sign_bit:
                raise ProtocolError(
                    f"{value} does not fit into {self.name} ({self.sign_bit} bits and a sign)"
                )
        try:
            return number.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError as error:
            raise ProtocolError(f"{value} does not fit into {self.name} ({self.size} bytes)") from error

    def decode(self, data: bytes) -> int:
        """The value of bytes. ProtocolError: not as many bytes as it has.

        Args:
            data: bytes as they were read.
        """
        if len(data) != self.size:
            raise ProtocolError(f"{self.name} came with {len(data)} bytes instead of {self.size}")
        return self.signed_value(int.from_bytes(data, "little", signed=self.signed))

    def signed_value(self, number: int) -> int:
        """The value of a number whose sign bit, if there is one, stands for minus.

        Args:
            number: as it was read, without a sign.
        """
        if self.sign_bit is None:
            return number
        magnitude = number & ((1 << self.sign_bit) - 1)
        return -magnitude if number >> self.sign_bit & 1 else magnitude
