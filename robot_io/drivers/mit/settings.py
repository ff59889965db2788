"""What a robot file says of MIT-mode motors on a CAN bus."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from robot_io.drivers.can.line import CanLineSettings
from robot_io.drivers.can.motors import MotorMounting
from robot_io.drivers.mit.makers import DIALECTS, Dialect, Maker
from robot_io.drivers.mit.protocol import MitRanges
from robot_io.drivers.mit.registers import REGISTERS_ID
from robot_io.files.file_model import FileModel, Number, between

USUAL_ANSWER_OFFSET, LARGEST_ROBSTRIDE_HOST = 16, 0xFF


class MitRangeSettings(FileModel):
    """Ranges of a motor whose parameters were changed."""

    position_rad: Annotated[Number, between(0.1, 1e4, "rad")]  # position range, plus and minus [rad]
    velocity_rad_s: Annotated[Number, between(0.1, 1e4, "rad/s")]  # velocity range, plus and minus [rad/s]
    torque_nm: Annotated[Number, between(0.1, 1e4, "N m")]  # torque range, plus and minus [N m]


class MitMotor(MotorMounting):
    """One motor. It reports at its output shaft, so that `gear_ratio` is only what comes after it."""

    motor_id: Annotated[int, Field(ge=1, le=255, strict=True)]  # its CAN id
    model: str  # which ranges it has, see `makers`
    ranges: MitRangeSettings | None = None  # its ranges, if they are not those of the model
    # Arbitration id of its answers (Damiao's "master id"); None is its own id and 16, as Damiao recommends.
    answer_id: Annotated[int, Field(ge=1, lt=REGISTERS_ID, strict=True)] | None = None


class MitBusSettings(CanLineSettings):
    """What the robot file says."""

    maker: Maker = Maker.CUBEMARS  # whose motors they are
    motors: Annotated[tuple[MitMotor, ...], Field(min_length=1)]  # one per joint, from base to tip
    # Id to which the motors answer; None is 0, and 253 for Robstride's. An answer under the motor's own id is
    # taken too, except from Robstride's. Damiao's motors have an `answer_id` each instead.
    host_id: Annotated[int, Field(ge=0, le=0x7FF, strict=True)] | None = None
    # After how long without a command a motor lets go [s] (CAN timeout). It is written to Damiao's and
    # Robstride's motors and read back, and Robstride's must have left motor mode after a silence at each
    # activation. With others the protocol can do neither: every motor gets 1 % of its torque, and must have
    # let go after the silence. Without commands for so long the host sends zero torque as well, for a motor
    # can only be read by commanding it.
    watchdog_s: Annotated[Number, Field(ge=1e-3, le=1)] = 0.1
    # What makes a motor without torque say its state: "exit" keeps it off, as in the firmware that the
    # protocol comes from, which answers every frame; "enter" is what the AK manual names for motors that are
    # deaf to commands outside of motor mode, and zero torque and "exit" follow it. It is refused for motors
    # that may be in another mode when they are asked, such as one that holds a position.
    ask_with: Literal["exit", "enter"] = "exit"

    @model_validator(mode="after")
    def _agree(self) -> "MitBusSettings":
        ids = [motor.motor_id for motor in self.motors]
        if len(set(ids)) != len(ids):
            raise ValueError(f"motors: ids {ids} are not all different")
        if max(ids) > self.dialect.largest_id:
            raise ValueError(
                f"motors: ids {ids}: a motor of '{self.maker}' has at most {self.dialect.largest_id}"
            )
        if self.maker is Maker.ROBSTRIDE and self.host > LARGEST_ROBSTRIDE_HOST:
            raise ValueError(
                f"host_id {self.host}: is at most {LARGEST_ROBSTRIDE_HOST} for Robstride's motors"
            )
        if self.ask_with == "enter" and self.dialect.set_up:
            raise ValueError(
                f"ask_with 'enter': would power motors of '{self.maker}' in whatever mode they are"
            )
        if self.dialect.has_answer_ids and self.host_id is not None:
            raise ValueError("host_id: Damiao motors have an 'answer_id' each instead")
        if not self.dialect.has_answer_ids and any(motor.answer_id is not None for motor in self.motors):
            raise ValueError(
                f"motors: 'answer_id' is Damiao's; those of maker '{self.maker}' have one 'host_id'"
            )
        self._check_answer_ids(ids)
        models = self.dialect.models
        unknown = [motor.model for motor in self.motors if motor.ranges is None and motor.model not in models]
        if unknown:
            raise ValueError(
                f"motors: no ranges are known for '{unknown[0]}' of maker '{self.maker}'. "
                f"Valid: {', '.join(models)}, or state 'ranges'"
            )
        return self

    def _check_answer_ids(self, motor_ids: list[int]) -> None:
        """An answer under a motor's id would be a command to it."""
        has_own = self.dialect.has_answer_ids
        answer_ids = [self.answer_ids(motor)[0] for motor in self.motors] if has_own else [self.host]
        wrong = [one for one in answer_ids if one in motor_ids or answer_ids.count(one) > 1]
        if wrong:
            raise ValueError(f"answer id {wrong[0]} is a motor's id, or that of two motors' answers")

    @property
    def dialect(self) -> Dialect:
        """How these motors speak."""
        return DIALECTS[self.maker]

    @property
    def host(self) -> int:
        """To whom the motors answer."""
        return self.dialect.host_id if self.host_id is None else self.host_id

    def wire_ranges(self, motor: MitMotor) -> MitRanges:
        """What the numbers on the wire mean."""
        own = motor.ranges
        if own is None:
            return self.dialect.models[motor.model]
        return MitRanges(own.position_rad, own.velocity_rad_s, own.torque_nm)

    def answer_ids(self, motor: MitMotor) -> tuple[int, ...]:
        """Arbitration ids under which a motor's answers are taken."""
        if self.dialect.has_answer_ids:
            return (motor.answer_id or motor.motor_id + USUAL_ANSWER_OFFSET,)
        return (self.host, motor.motor_id)
