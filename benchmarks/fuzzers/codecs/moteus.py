"""moteus controllers: what is accepted must be one answer, and give it when it is written once more."""

import struct

import numpy as np

from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.moteus import protocol as moteus

from ..fuzzer import Fuzzer

_FLOATS = struct.Struct("<fff")


class MoteusFuzzer(Fuzzer):
    """States of one controller."""

    name = "moteus"

    def frame(self, rng: np.random.Generator) -> bytes:
        floats = rng.bytes(12) if rng.random() < 0.5 else _FLOATS.pack(*rng.normal(size=3))
        return b"\x21\x00" + rng.bytes(1) + b"\x2f\x01" + floats + b"\x20\x04\x0c" + rng.bytes(4)

    def decode(self, data: bytes) -> list[object]:
        return [moteus.decode_state(CanFrame(0x100, data, fd=True))]

    def is_wrong(self, data: bytes, accepted: object) -> bool:
        if not isinstance(accepted, moteus.MoteusState):
            return True
        floats = (accepted.position_rev, accepted.velocity_rev_s, accepted.torque_nm)
        rest = (accepted.home, round(2.0 * accepted.supply_v), accepted.temperature_c, accepted.fault)
        again = bytes((0x21, 0x00, accepted.mode % 256, 0x2F, 0x01)) + _FLOATS.pack(*floats)
        again += bytes((0x20, 0x04, 0x0C, *(one % 256 for one in rest)))
        finite = bool(np.isfinite(floats).all())
        return (finite and again != data) or len(again) != len(data) or accepted.is_known != finite
