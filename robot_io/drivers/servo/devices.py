"""Encoders and drives of a bus of servos."""

from collections.abc import Mapping
from math import exp, pi
from typing import ClassVar, Literal

import numpy as np

from robot_io.driver import DriverContext
from robot_io.drivers.servo.bus import ServoBus
from robot_io.drivers.servo.joints import ServoSample
from robot_io.files.file_model import FileModel, Positive
from robot_io.interfaces import JointEncoder, JointTorque
from robot_io.types import FloatArray, Reading, Status


class ServoEncoderSettings(FileModel):
    """How the velocity is come by."""

    # "servo" takes what the servo derives; "difference" differentiates the position, whose steps show, and
    # smooths it.
    velocity: Literal["servo", "difference"] = "servo"
    bandwidth_hz: Positive = 60.0  # of the first-order low-pass on the difference [Hz]


class ServoEncoder(JointEncoder):
    """Positions and velocities from a bus of servos."""

    bus_type: ClassVar[type[ServoBus]]

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(ServoEncoderSettings, settings)
        self._bus = context.bus_as(self.bus_type)
        self._differentiate = own.velocity == "difference"
        self._bandwidth_hz = own.bandwidth_hz
        self._before: ServoSample | None = None
        self._smooth_rad_s: FloatArray = np.full(self.joint_count, np.nan)

    @property
    def joint_count(self) -> int:
        return self._bus.joint_count

    def read_position(self) -> Reading:
        sample = self._bus.sample
        return self._unknown() if sample is None else Reading(sample.position_rad, sample.sampled_at_s)

    def read_velocity(self) -> Reading:
        sample = self._bus.sample
        if sample is None:
            return self._unknown()
        velocity_rad_s = self._difference(sample) if self._differentiate else sample.velocity_rad_s
        return Reading(velocity_rad_s, sample.sampled_at_s)

    def _unknown(self) -> Reading:
        return Reading(np.full(self.joint_count, np.nan), -np.inf, Status.STALE)

    def _difference(self, sample: ServoSample) -> FloatArray:
        """Starts from the servo's own velocity."""
        before, self._before = self._before, sample
        if before is None:
            self._smooth_rad_s = sample.velocity_rad_s
        elif before is not sample:
            elapsed_s = sample.sampled_at_s - before.sampled_at_s
            raw_rad_s = (sample.position_rad - before.position_rad) / elapsed_s
            share = 1.0 - exp(-2.0 * pi * self._bandwidth_hz * elapsed_s)
            self._smooth_rad_s = self._smooth_rad_s + share * (raw_rad_s - self._smooth_rad_s)
        return self._smooth_rad_s


class ServoTorque(JointTorque):
    """The drives of a bus of servos."""

    bus_type: ClassVar[type[ServoBus]]

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(self.bus_type)

    @property
    def joint_count(self) -> int:
        return self._bus.joint_count

    def activate(self) -> None:
        """Torque on, at zero until the first command."""
        self._bus.torque_on()

    def deactivate(self) -> None:
        """Torque off, confirmed by every servo."""
        self._bus.torque_off()

    def read_torque(self) -> Reading:
        sample = self._bus.sample
        if sample is None:
            return Reading(np.full(self.joint_count, np.nan), -np.inf, Status.STALE)
        return Reading(sample.torque_nm, sample.sampled_at_s, sample.torque_status)

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        return self._bus.stage(torque_nm)
