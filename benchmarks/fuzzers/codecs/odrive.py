"""ODrive CANSimple. CAN's checksum is in the adapter; what is accepted must be what numpy reads there."""

import numpy as np

from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.odrive import protocol as odrive
from robot_io.drivers.odrive.protocol import Firmware

from ..fuzzer import Fuzzer

_STATES = {0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14}
_ODD_FLOATS = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3e38], dtype="<f4")
_PARTS = ("motor", "encoder", "controller")  # with a flag each in the last three bytes, with 0.5


class OdriveFuzzer(Fuzzer):
    """The first byte says which message it is, the rest is its data."""

    name = "odrive"

    def frame(self, rng: np.random.Generator) -> bytes:
        """See `Fuzzer.frame`; floats may be none."""
        floats = rng.normal(size=2).astype("<f4")
        if rng.random() < 0.2:
            floats[rng.integers(2)] = rng.choice(_ODD_FLOATS)
        beat = rng.bytes(4) + bytes((8, *rng.integers(256, size=3).tolist()))
        return bytes((int(rng.integers(6)),)) + (beat if rng.random() < 0.3 else floats.tobytes())

    def decode(self, data: bytes) -> list[object]:
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
        if len(data) != 9:
            return True
        kind, content = data[0] % 6, np.frombuffer(data[1:], dtype=np.uint8)
        if kind == 5:
            return accepted != tuple(content[4:7].tolist())
        if kind > 1:
            floats = content.view("<f4")
            return not np.isfinite(floats).all() or accepted != tuple(floats.tolist())
        error, state, *flags = int(content[:4].view("<u4")[0]), *content[4:].tolist()
        failed = tuple(part for part, flag in zip(_PARTS, flags, strict=True) if flag & 1)
        done = bool(flags[2] & 0x80) if kind == 0 else bool(flags[1] & 1)
        expected = (error, state, failed, 0, done) if kind == 0 else (error, state, (), flags[0], done)
        beat = accepted
        return (
            not isinstance(beat, odrive.Heartbeat)
            or state not in _STATES
            or (
                beat.axis_error,
                beat.state,
                beat.component_errors,
                beat.procedure_result,
                beat.trajectory_done,
            )
            != expected
        )
