"""Settings of motors in MIT mode, and the differences between their makers.

Sources: CubeMars "AK Series Actuator Driver Manual" V1.0.8, section 5.3 (table of parameter ranges, errors);
Damiao, "DM-J4310-2EC user manual" and its table of default PMAX, VMAX and TMAX; RobStride, user manuals of
RS00 to RS06 of 2026-04-28, section 4.1 (types 1, 2 and 21; the maker's Python samples have other ranges).
"""

from dataclasses import dataclass
from enum import StrEnum
from math import pi
from typing import Annotated, Literal

from pydantic import Field, model_validator

from palpate.robot_io.drivers.can.line import CanLineSettings
from palpate.robot_io.drivers.can.motors import MotorMounting
from palpate.robot_io.drivers.mit import protocol
from palpate.robot_io.drivers.mit.protocol import (
    FAULT_FRAME_BITS,
    REGISTERS_ID,
    DamiaoFrames,
    MitFrames,
    MitRanges,
    MotorRegister,
    RobstrideFrames,
)
from palpate.robot_io.files.file_model import FileModel, Number, between


class Maker(StrEnum):
    """Maker of the motors; all motors on a bus have the same maker."""

    CUBEMARS = "cubemars"  # and others whose firmware is the Mini Cheetah's
    DAMIAO = "damiao"
    ROBSTRIDE = "robstride"


@dataclass(frozen=True, slots=True)
class MitProtocol:
    """Protocol details of one maker's motors."""

    frames: type[MitFrames]  # encodes requests and parses answers
    models: dict[str, MitRanges]  # ranges of each model, as delivered
    errors: dict[int, str]  # name of each error; if errors are bits, of each bit
    encoder_fault: int | None  # number or bit of the encoder fault, if the maker defines one
    largest_id: int  # largest CAN id of a motor
    host_id: int = 0  # id under which motors answer, unless the robot file states another
    errors_are_bits: bool = False  # whether a state holds error bits instead of one error number
    has_answer_ids: bool = False  # whether each motor answers under its own id
    # Whether a motor with active reporting sends states like answers (Robstride's firmware before type 24).
    may_report: bool = False
    timeout_error: int | None = None  # number of the error "CAN timeout", which each activation clears
    # Registers of the ranges of position, velocity and torque, and of the position; read by `configure`.
    range_registers: tuple[MotorRegister, ...] = ()
    position_register: MotorRegister | None = None
    # Registers that each activation writes and reads back, with their values: the mode, and the CAN timeout
    # (None: its value is in the robot file). Motors that have them report whether they are in motor mode.
    activation_registers: tuple[tuple[MotorRegister, int | None], ...] = ()

    def error_names(self, error: int) -> str:
        """Name an error; if errors are bits, name each bit.

        Args:
            error: number or bits in a state.
        """
        if not self.errors_are_bits:
            return self.errors.get(error, f"unknown error {error}")
        places = [place for place in range(error.bit_length()) if error >> place & 1]
        names = (self.errors.get(1 << n, f"unknown fault, bit {n - FAULT_FRAME_BITS}") for n in places)
        return ", ".join(dict.fromkeys(names))


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
    9: "position not initialized",
    14: "overload, stalled",
    16: "over current in phase A",
    32: "near over temperature",  # a warning
}

DIALECTS = {
    Maker.CUBEMARS: MitProtocol(
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
    Maker.DAMIAO: MitProtocol(
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
        largest_id=15,  # a state has four bits for it
        has_answer_ids=True,
        timeout_error=13,
        range_registers=(protocol.POSITION_RANGE, protocol.VELOCITY_RANGE, protocol.TORQUE_RANGE),
        activation_registers=(
            (protocol.CONTROL_MODE, protocol.MIT_MODE),
            (protocol.DAMIAO_CAN_TIMEOUT, None),
        ),
    ),
    Maker.ROBSTRIDE: MitProtocol(
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
        may_report=True,
        encoder_fault=1 << _ROBSTRIDE_STATE.index("encoder fault"),
        largest_id=127,
        host_id=0xFD,
        position_register=protocol.POSITION,
        activation_registers=(
            (protocol.RUN_MODE, protocol.OPERATION_CONTROL),
            (protocol.ROBSTRIDE_CAN_TIMEOUT, None),
        ),
    ),
}


USUAL_ANSWER_OFFSET, LARGEST_ROBSTRIDE_HOST = 16, 0xFF


class MitRangeSettings(FileModel):
    """Ranges of a motor whose parameters were changed."""

    position_rad: Annotated[Number, between(0.1, 1e4, "rad")]  # position range, plus and minus [rad]
    velocity_rad_s: Annotated[Number, between(0.1, 1e4, "rad/s")]  # velocity range, plus and minus [rad/s]
    torque_nm: Annotated[Number, between(0.1, 1e4, "N m")]  # torque range, plus and minus [N m]


class MitMotor(MotorMounting):
    """One motor. Its values are of its output shaft; `gear_ratio` is that of a further gear behind it."""

    motor_id: Annotated[int, Field(ge=1, le=255, strict=True)]  # its CAN id
    model: str  # model, which determines its ranges
    ranges: MitRangeSettings | None = None  # its ranges, if they differ from the model's
    # Arbitration id of its answers (Damiao's "master id"); None: its own id plus 16, as Damiao recommends.
    answer_id: Annotated[int, Field(ge=1, lt=REGISTERS_ID, strict=True)] | None = None


class MitBusSettings(CanLineSettings):
    """Settings in the robot file."""

    maker: Maker = Maker.CUBEMARS  # maker of the motors
    motors: Annotated[tuple[MitMotor, ...], Field(min_length=1)]  # one per joint, from base to tip
    # CAN id to which the motors answer; None: 0, or 253 for Robstride motors. Answers under a motor's own id
    # are accepted too, except from Robstride motors. Each Damiao motor has an `answer_id` instead.
    host_id: Annotated[int, Field(ge=0, le=0x7FF, strict=True)] | None = None
    # CAN timeout: time without a command after which a motor switches its torque off [s]. It is written to
    # Damiao and Robstride motors and read back. Each activation tests it on all motors but Damiao's: after a
    # silence, Robstride motors must have left motor mode, and the torque of others, 1 % before the silence,
    # must be zero. A motor can only be read by commanding it, so that after this time without a command the
    # host sends zero torque.
    watchdog_s: Annotated[Number, Field(ge=1e-3, le=1)] = 0.1
    # Command that makes a motor outside of motor mode report its state. "exit" keeps it off; the firmware of
    # the Mini Cheetah answers it. "enter" is for motors that answer no other command outside of motor mode
    # (AK manual); zero torque and "exit" follow it. It is refused for motors that may be in another mode when
    # their state is requested, such as position control.
    ask_with: Literal["exit", "enter"] = "exit"

    @model_validator(mode="after")
    def _check_consistency(self) -> "MitBusSettings":
        ids = [motor.motor_id for motor in self.motors]
        if len(set(ids)) != len(ids):
            raise ValueError(f"motors: ids {ids} are not all different")
        if max(ids) > self.dialect.largest_id:
            raise ValueError(
                f"motors: ids {ids}: the largest id of '{self.maker}' is {self.dialect.largest_id}"
            )
        if self.maker is Maker.ROBSTRIDE and self.host > LARGEST_ROBSTRIDE_HOST:
            raise ValueError(
                f"host_id {self.host}: Robstride's motors allow at most {LARGEST_ROBSTRIDE_HOST}"
            )
        if self.ask_with == "enter" and self.dialect.activation_registers:
            raise ValueError(
                f"ask_with 'enter' is not allowed, because it would power motors of '{self.maker}'"
            )
        if self.dialect.has_answer_ids and self.host_id is not None:
            raise ValueError("host_id: Damiao motors each have an 'answer_id' instead")
        if not self.dialect.has_answer_ids and any(motor.answer_id is not None for motor in self.motors):
            raise ValueError(
                f"motors: only Damiao motors have an 'answer_id'; give '{self.maker}' one 'host_id' for all"
            )
        # An answer under a motor's id would be a command to it.
        has_own = self.dialect.has_answer_ids
        answer_ids = [self.answer_ids(motor)[0] for motor in self.motors] if has_own else [self.host]
        twice = [number for number in answer_ids if number in ids or answer_ids.count(number) > 1]
        if twice:
            name = "answer_id" if has_own else "host_id"
            raise ValueError(
                f"{name} {twice[0]} is already in use as a motor's id or for another motor's answers; "
                "choose a free one"
            )
        models = self.dialect.models
        unknown = [motor.model for motor in self.motors if motor.ranges is None and motor.model not in models]
        if unknown:
            raise ValueError(
                f"motors: no ranges are known for '{unknown[0]}' of maker '{self.maker}'. "
                f"Valid: {', '.join(models)}, or state 'ranges'"
            )
        return self

    @property
    def dialect(self) -> MitProtocol:
        """Protocol details of these motors."""
        return DIALECTS[self.maker]

    @property
    def host(self) -> int:
        """CAN id to which the motors answer."""
        return self.dialect.host_id if self.host_id is None else self.host_id

    def answer_ids(self, motor: MitMotor) -> tuple[int, ...]:
        """Return the arbitration ids under which a motor's answers are accepted.

        Args:
            motor: motor of this bus. If the dialect has answer ids and the motor states none, the usual
                offset is added to its id.
        """
        if self.dialect.has_answer_ids:
            return (motor.answer_id or motor.motor_id + USUAL_ANSWER_OFFSET,)
        return (self.host, motor.motor_id)
