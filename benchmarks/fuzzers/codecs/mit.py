"""MIT-mode motors. CAN's checksum is in the adapter; what is accepted must be packed to the same bits."""

import numpy as np

from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.mit import protocol as mit
from robot_io.drivers.mit.makers import DIALECTS, Maker
from robot_io.drivers.mit.robstride import RobstrideFrames

from ..fuzzer import Fuzzer

_RANGES = DIALECTS[Maker.CUBEMARS].models["AK70-10"]
_FIELDS = (
    (12.5, 16),
    (50.0, 12),
    (25.0, 12),
)  # of position, velocity and torque: range and bits, by the manual


class MitFuzzer(Fuzzer):
    """States of one motor."""

    name = "mit"

    def frame(self, rng: np.random.Generator) -> bytes:
        return b"\x01" + rng.bytes(5 if rng.random() < 0.3 else 7)

    def decode(self, data: bytes) -> list[object]:
        return [mit.decode_state(CanFrame(0, data), _RANGES)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: written bit by bit, each number must stand where it came from."""
        if not isinstance(accepted, mit.MitState) or len(data) not in (6, 8):
            return True
        bits = f"{accepted.motor_id:08b}"
        values = (accepted.position_rad, accepted.velocity_rad_s, accepted.torque_nm)
        for value, (limit, count) in zip(values, _FIELDS, strict=True):
            number = round((value + limit) / (2.0 * limit) * (2**count - 1))
            bits += f"{number:0{count}b}" if 0 <= number < 2**count else "beyond"
        came = "".join(f"{byte:08b}" for byte in data)
        error = int(came[56:], 2) if len(data) == 8 else 0
        at_end = any(len(set(field)) == 1 for field in (came[8:24], came[24:36]))
        return bits != came[:48] or accepted.error != error or accepted.at_range_end != at_end


class DamiaoFuzzer(MitFuzzer):
    """States of one of Damiao's, whose status stands above the id, and whose last bytes are temperatures."""

    name = "mit_damiao"

    def decode(self, data: bytes) -> list[object]:
        return [mit.decode_state(CanFrame(0, data), _RANGES, status_beside_id=True)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: as if id and status stood where others have them."""
        if not isinstance(accepted, mit.MitState) or len(data) != 8:
            return True
        status = data[0] // 16
        enabled, error = status == 1, status if status > 1 else 0
        if (accepted.enabled, accepted.error) != (enabled, error):
            return True
        plain = bytes((data[0] % 16, *data[1:7], error))
        return super().is_wrong(plain, accepted)


class RobstrideFuzzer(Fuzzer):
    """States of one of Robstride's; the first four bytes of an input are the id."""

    name = "mit_robstride"

    def __init__(self) -> None:
        self._frames = RobstrideFrames(0xFD, {})

    def frame(self, rng: np.random.Generator) -> bytes:
        return bytes((2, int(rng.integers(256)), 1, 0xFD)) + rng.bytes(8)

    def decode(self, data: bytes) -> list[object]:
        frame = CanFrame(int.from_bytes(data[:4], "big") & 0x1FFFFFFF, data[4:], extended=True)
        if self._frames.sender(frame) != 1:
            return []
        return [self._frames.state(frame, _RANGES)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`: by the bits of the manual, of motor 1 to host FD."""
        if not isinstance(accepted, mit.MitState) or len(data) != 12:
            return True
        bits = "".join(f"{byte:08b}" for byte in data)
        said = (accepted.position_rad / 12.5, accepted.velocity_rad_s / 50.0, accepted.torque_nm / 25.0)
        numbers = "".join(f"{round((share + 1.0) / 2.0 * 65535):016b}" for share in said)
        mode = {True: ("10",), False: ("00", "01")}.get(bool(accepted.enabled), ())
        at_end = any(len(set(field)) == 1 for field in (bits[32:48], bits[48:64]))
        return (
            bits[3:8] + bits[16:32] != "00010" + "00000001" + "11111101"
            or bits[8:10] not in mode
            or accepted.error != int(bits[10:16], 2)
            or (accepted.motor_id, accepted.at_range_end) != (1, at_end)
            or numbers != bits[32:80]
        )
