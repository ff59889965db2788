"""What a scenario says about the sensors."""

from typing import Annotated, Literal

from pydantic import Field

from robot_io.files.file_model import FileModel, NotNegative, Number, Positive

Rate = Field(default=1000.0, gt=0, le=1e6)
Delay = Annotated[NotNegative, Field(le=10.0)]  # [s]


class ForceSettings(FileModel):
    """A uniaxial load cell with its amplifier and converter."""

    noise_std_n: NotNegative = 0.02  # white noise of a sample [N]
    resolution_n: NotNegative = 0.005  # one step of the converter [N]; 0 is none
    range_n: Positive = 100.0  # end of the range, push or pull [N]; a sample there is marked as saturated
    bandwidth_hz: Positive | None = None  # first-order low-pass ahead of the converter [Hz]; None is none
    rate_hz: Positive = Rate  # samples per second [Hz]
    delay_s: Delay = 0.0  # from the sampling instant until a sample can be read [s]


class TorqueSettings(FileModel):
    """The drives' own measurement of torque, from their current."""

    noise_std_nm: NotNegative = 0.01  # white noise of a sample [N m]
    resolution_nm: NotNegative = 0.002  # one step of the measurement [N m]; 0 is none
    # One step of the torque that a drive can be told [N m]; 0 is none.
    command_resolution_nm: NotNegative = 0.001
    rate_hz: Positive = Rate  # samples per second [Hz]
    delay_s: Delay = 0.0  # from the sampling instant until a sample can be read [s]
    # Where in the sampling period a sample is taken, from 0 to 1. Half way is the middle of the time for
    # which a command of the same rate holds: torque and motion of that time go together.
    phase: Number = Field(default=0.5, ge=0, lt=1)


class VelocitySettings(FileModel):
    """Where the velocity comes from."""

    # "difference" is what a drive derives from its own encoder: the difference of two samples, low-passed; it
    # lags by half a sample and the filter's time. "tachometer" measures it, with noise.
    source: Literal["difference", "tachometer"] = "difference"
    bandwidth_hz: Positive = 200.0  # first-order low-pass of the difference [Hz]
    noise_std_rad_s: NotNegative = 0.002  # white noise of the tachometer [rad/s]


class EncoderSettings(FileModel):
    """Encoders on the motor side of a gear, seen from the joint."""

    # Steps in one revolution of the joint; 2^14 counts through a gear of 50:1.
    counts_per_revolution: Number = Field(default=819_200.0, gt=0, le=1e12)
    velocity: VelocitySettings = VelocitySettings()  # where the velocity comes from
    # Samples per second inside the drive [Hz]; the robot reads the newest one.
    rate_hz: Number = Field(default=2000.0, gt=0, le=1e6)
    delay_s: Delay = 0.0  # from the sampling instant until a sample can be read [s]


class SensorSettings(FileModel):
    """All sensors of one arm."""

    encoder: EncoderSettings = EncoderSettings()
    torque: TorqueSettings = TorqueSettings()
    force: ForceSettings = ForceSettings()
