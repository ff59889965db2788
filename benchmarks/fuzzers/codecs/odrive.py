"""ODrive CANSimple. CAN's checksum is in the adapter; here lengths, states and floats must be right."""

from math import isfinite
from typing import ClassVar

import numpy as np

from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.odrive import protocol as odrive
from robot_io.drivers.odrive.protocol import Firmware

from ..fuzzer import Fuzzer

_STATES = {0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14}


class OdriveFuzzer(Fuzzer):
    """The first byte says which message it is, the rest is its data."""

    name: ClassVar[str] = "odrive"

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`."""
        floats = rng.normal(size=2).astype("<f4").tobytes()
        beat = bytes((0, 0, 0, 0, 8, 0, 0, 0))
        return bytes((int(rng.integers(6)),)) + (beat if rng.random() < 0.3 else floats)

    def decode(self, data: bytes) -> list[object]:
        """See `Fuzzer.decode`."""
        frame = CanFrame(0x20, data[1:])
        match data[0] % 6 if data else 0:
            case 0:
                return [odrive.decode_heartbeat(frame, Firmware.V0_5)]
            case 1:
                return [odrive.decode_heartbeat(frame, Firmware.V0_6)]
            case 2:
                return [odrive.decode_encoder_estimates(frame)]
            case 3:
                return [odrive.decode_torques(frame)]
            case 4:
                return [odrive.decode_iq(frame)]
            case _:
                return [odrive.decode_version(frame)]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        """See `Fuzzer.is_wrong`."""
        if len(data) != 9:
            return True
        if isinstance(accepted, odrive.Heartbeat):
            return data[5] not in _STATES
        return not all(map(isfinite, accepted))  # type: ignore[call-overload]
