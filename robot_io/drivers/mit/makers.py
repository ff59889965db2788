"""What differs between makers of MIT-mode motors, as data.

Sources: CubeMars "AK Series Actuator Driver Manual" V1.0.8, section 5.3 (table of parameter ranges, errors);
Damiao, "DM-J4310-2EC user manual" and its table of default PMAX, VMAX and TMAX; RobStride, user manuals of
RS00 to RS06 of 2026-04-28, section 4.1 (types 1, 2 and 21; the maker's Python samples have other ranges).
"""

from dataclasses import dataclass
from enum import StrEnum
from math import pi

from robot_io.drivers.mit import registers, robstride
from robot_io.drivers.mit.frames import DamiaoFrames, MitFrames
from robot_io.drivers.mit.protocol import MitRanges
from robot_io.drivers.mit.registers import MotorRegister
from robot_io.drivers.mit.robstride import FAULT_FRAME_BITS, RobstrideFrames


class Maker(StrEnum):
    """Whose motors they are; all on a bus are of one."""

    CUBEMARS = "cubemars"  # and others whose firmware is the Mini Cheetah's
    DAMIAO = "damiao"
    ROBSTRIDE = "robstride"


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one maker's motors speak."""

    frames: type[MitFrames]  # what is sent and answered
    models: dict[str, MitRanges]  # ranges of each model, as delivered
    errors: dict[int, str]  # what an error means; where errors are bits, each bit
    encoder_fault: int | None  # the error of the encoder, if it has one
    largest_id: int  # of a motor
    host_id: int = 0  # under which motors answer, unless the robot file says another
    errors_are_bits: bool = False
    has_answer_ids: bool = False  # whether each motor answers under an id of its own
    timeout_error: int | None = None  # the error of a CAN timeout that has fired; each activation clears it
    # Registers that hold its ranges of position, velocity and torque, or its position; read when configured.
    range_registers: tuple[MotorRegister, ...] = ()
    position_register: MotorRegister | None = None
    # Registers that each activation writes and reads back: the mode, and the CAN timeout, which has no value
    # here. A motor that has them says in its states whether it is in motor mode.
    set_up: tuple[tuple[MotorRegister, int | None], ...] = ()

    def error_names(self, error: int) -> str:
        """What an error means."""
        parts = [1 << place for place in range(error.bit_length()) if error >> place & 1]
        parts = parts if self.errors_are_bits else [error]
        return ", ".join(dict.fromkeys(self.errors.get(part, f"unknown error {part}") for part in parts))

    def is_encoder_fault(self, error: int) -> bool:
        """Whether its position means nothing."""
        fault = self.encoder_fault
        return fault is not None and bool(error & fault if self.errors_are_bits else error == fault)


_FOUR_TURNS = 4.0 * pi
_ROBSTRIDE_STATE = ("under voltage", "over current", "over temperature", "encoder fault", "overload, stalled")
_ROBSTRIDE_FAULTS = {
    0: "over temperature",
    1: "driver chip",
    2: "under voltage",
    3: "over voltage",
    4: "over current in phase B",
    5: "over current in phase C",
    7: "encoder not calibrated",
    8: "hardware not identified",
    9: "position not initialised",
    14: "overload, stalled",
    16: "over current in phase A",
}

DIALECTS = {
    Maker.CUBEMARS: Dialect(
        frames=MitFrames,
        models={
            "AK10-9": MitRanges(12.5, 50.0, 65.0),
            "AK60-6": MitRanges(12.5, 45.0, 15.0),
            "AK70-10": MitRanges(12.5, 50.0, 25.0),
            "AK80-6": MitRanges(12.5, 76.0, 12.0),
            "AK80-9": MitRanges(12.5, 50.0, 18.0),
            "AK80-64": MitRanges(12.5, 8.0, 144.0),  # the manual's column is headed AK80-80/64
            "AK80-80": MitRanges(12.5, 8.0, 144.0),
        },
        errors={
            1: "motor over temperature",
            2: "over current",
            3: "over voltage",
            4: "under voltage",
            5: "encoder fault",
            6: "MOSFET over temperature",
            7: "motor stalled",
        },
        encoder_fault=5,
        largest_id=255,
    ),
    Maker.DAMIAO: Dialect(
        frames=DamiaoFrames,
        models={
            "DM-J3507": MitRanges(12.566, 50.0, 5.0),
            "DM-J4310": MitRanges(12.5, 30.0, 10.0),
            "DM-J4340": MitRanges(12.5, 8.0, 28.0),
            "DM-J6006": MitRanges(12.5, 45.0, 20.0),
            "DM-J8006": MitRanges(12.5, 45.0, 40.0),
            "DM-J8009": MitRanges(12.5, 45.0, 54.0),
            "DM-J10010": MitRanges(12.5, 20.0, 200.0),
            "DM-J10010L": MitRanges(12.5, 25.0, 200.0),
        },
        errors={
            8: "over voltage",
            9: "under voltage",
            10: "over current",
            11: "MOSFET over temperature",
            12: "motor over temperature",
            13: "lost communication: its CAN timeout has fired",
            14: "overload",
        },
        encoder_fault=None,
        largest_id=15,  # four bits of it are said
        has_answer_ids=True,
        timeout_error=13,
        range_registers=(registers.POSITION_RANGE, registers.VELOCITY_RANGE, registers.TORQUE_RANGE),
        set_up=((registers.CONTROL_MODE, registers.MIT_MODE), (registers.CAN_TIMEOUT, None)),
    ),
    Maker.ROBSTRIDE: Dialect(
        frames=RobstrideFrames,
        models={
            "RS00": MitRanges(_FOUR_TURNS, 33.0, 14.0),
            "RS01": MitRanges(_FOUR_TURNS, 44.0, 17.0),
            "RS02": MitRanges(_FOUR_TURNS, 44.0, 17.0),
            "RS03": MitRanges(_FOUR_TURNS, 20.0, 60.0),
            "RS04": MitRanges(_FOUR_TURNS, 15.0, 120.0),
            "RS05": MitRanges(_FOUR_TURNS, 50.0, 5.5),
            "RS06": MitRanges(_FOUR_TURNS, 50.0, 36.0),
        },
        errors={
            **{1 << bit: name for bit, name in enumerate((*_ROBSTRIDE_STATE, "encoder not calibrated"))},
            **{1 << bit + FAULT_FRAME_BITS: name for bit, name in _ROBSTRIDE_FAULTS.items()},
        },
        errors_are_bits=True,
        encoder_fault=1 << _ROBSTRIDE_STATE.index("encoder fault"),
        largest_id=127,
        host_id=0xFD,
        position_register=robstride.POSITION,
        set_up=((robstride.RUN_MODE, robstride.OPERATION_CONTROL), (robstride.CAN_TIMEOUT, None)),
    ),
}
