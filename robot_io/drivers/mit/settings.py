"""What a robot file says of MIT-mode motors on a CAN bus."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from robot_io.drivers.can.line import CanLineSettings
from robot_io.drivers.can.motors import MotorMounting
from robot_io.drivers.mit.protocol import MIT_MODELS, MitRanges
from robot_io.files.file_model import FileModel, Positive


class MitRangeSettings(FileModel):
    """Ranges of a motor whose parameters were changed."""

    position_rad: Positive  # position range, plus and minus [rad]
    velocity_rad_s: Positive  # velocity range, plus and minus [rad/s]
    torque_nm: Positive  # torque range, plus and minus [N m]


class MitMotor(MotorMounting):
    """One motor. It reports at its output shaft, so that `gear_ratio` is only what comes after it."""

    motor_id: Annotated[int, Field(ge=1, le=255, strict=True)]  # its CAN id
    model: str  # which ranges it has, see `MIT_MODELS`
    ranges: MitRangeSettings | None = None  # its ranges, if they are not those of the model

    @model_validator(mode="after")
    def _know_the_model(self) -> "MitMotor":
        if self.ranges is None and self.model not in MIT_MODELS:
            raise ValueError(
                f"no ranges are known for '{self.model}'. Valid: {', '.join(MIT_MODELS)}, or state 'ranges'"
            )
        return self

    @property
    def wire_ranges(self) -> MitRanges:
        """What the numbers on the wire mean."""
        if self.ranges is None:
            return MIT_MODELS[self.model]
        return MitRanges(self.ranges.position_rad, self.ranges.velocity_rad_s, self.ranges.torque_nm)


class MitBusSettings(CanLineSettings):
    """What the robot file says."""

    motors: Annotated[tuple[MitMotor, ...], Field(min_length=1)]  # one per joint, from base to tip
    # Arbitration id of the motors' answers; an answer under the motor's own id is taken too.
    host_id: Annotated[int, Field(ge=0, le=0x7FF, strict=True)] = 0
    # After how long without a command a motor lets go [s], as set in it (CAN timeout). The protocol can
    # neither set nor read it. Without commands for so long the host sends zero torque as well, for a motor
    # can only be read by commanding it.
    watchdog_s: Annotated[Positive, Field(le=1)] = 0.1
    # What makes a motor without torque say its state: "exit" keeps it off, as in the firmware that the
    # protocol comes from, which answers every frame; "enter" is what the AK manual names for motors that are
    # deaf to commands outside of motor mode, and zero torque and "exit" follow it.
    ask_with: Literal["exit", "enter"] = "exit"

    @model_validator(mode="after")
    def _agree(self) -> "MitBusSettings":
        ids = [motor.motor_id for motor in self.motors]
        if len(set(ids)) != len(ids):
            raise ValueError(f"motors: ids {ids} are not all different")
        return self
