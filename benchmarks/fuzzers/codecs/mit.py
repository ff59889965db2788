"""MIT-mode motors. CAN's own checksum is in the adapter; here lengths and ranges must hold."""

from typing import ClassVar

import numpy as np

from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.mit import protocol as mit
from robot_io.drivers.mit.protocol import MIT_MODELS

from ..fuzzer import Fuzzer

_RANGES = MIT_MODELS["AK70-10"]


class MitFuzzer(Fuzzer):
    """States of one motor."""

    name: ClassVar[str] = "mit"

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        return b"\x01" + rng.bytes(7)

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        return [mit.decode_state(CanFrame(0, data), _RANGES)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        state = accepted
        return (
            len(data) not in (6, 8)
            or not isinstance(state, mit.MitState)
            or not abs(state.position_rad) <= 12.5 + 1e-9
            or not abs(state.velocity_rad_s) <= 50.0 + 1e-9
            or not abs(state.torque_nm) <= 25.0 + 1e-9
        )
