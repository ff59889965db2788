"""What a robot file says of moteus controllers on a CAN FD bus."""

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from robot_io.drivers.can.line import CanLineSettings
from robot_io.drivers.can.motors import MotorMounting
from robot_io.files.file_model import Number
from robot_io.guard.limits import Torque


class MoteusMotor(MotorMounting):
    """One controller with its motor. It reports at its output: `gear_ratio` is what comes after it."""

    motor_id: Annotated[int, Field(ge=1, le=127, strict=True)]  # its CAN id
    max_torque_nm: Torque  # largest torque at its output, from servo.max_current_A [N m]


class MoteusBusSettings(CanLineSettings):
    """What the robot file says; `bitrate` is that of the arbitration, data travels at 5 Mbit/s."""

    fd: ClassVar = True

    motors: Annotated[tuple[MoteusMotor, ...], Field(min_length=1)]  # one per joint, from base to tip
    host_id: Annotated[int, Field(ge=0, le=127, strict=True)] = 0  # to whom they answer
    # After how long without a command a controller stops [s]. Each command carries it, in milliseconds, and
    # it is left to expire once at each activation.
    watchdog_s: Annotated[Number, Field(ge=1e-3, le=1)] = 0.1

    @model_validator(mode="after")
    def _agree(self) -> "MoteusBusSettings":
        ids = [motor.motor_id for motor in self.motors]
        if len({*ids, self.host_id}) <= len(ids):
            raise ValueError(f"motors: ids {ids} and host_id {self.host_id} are not all different")
        return self
