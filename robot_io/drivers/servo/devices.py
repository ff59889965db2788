"""Encoders of a bus of servos."""

from collections.abc import Mapping
from math import exp, pi
from typing import Literal

import numpy as np

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.joint_bus import BusEncoder
from palpate.robot_io.files.file_model import FileModel, Positive
from palpate.robot_io.types import FloatArray, Reading, Status


class ServoEncoderSettings(FileModel):
    """How the velocity is come by."""

    # "servo" takes what the servo derives; "difference" differentiates the position, whose steps show, and
    # smooths it.
    velocity: Literal["servo", "difference"] = "servo"
    bandwidth_hz: Positive = 60.0  # of the first-order low-pass on the difference [Hz]


class ServoEncoder(BusEncoder):
    """Positions and velocities from a bus of servos."""

    Settings = ServoEncoderSettings
    _own: ServoEncoderSettings

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        super().__init__(settings, context)
        self._before: Reading | None = None
        self._smooth_rad_s: FloatArray = np.full(self.joint_count, np.nan)

    def read_velocity(self) -> Reading:
        shown = self._bus.velocity
        if self._own.velocity == "servo" or shown.status is not Status.OK:
            return shown
        position = self._bus.position
        before, self._before = self._before, position
        if before is None:  # starts from the servo's own velocity
            self._smooth_rad_s = shown.value
        elif before is not position:
            elapsed_s = position.sampled_at_s - before.sampled_at_s
            raw_rad_s = (position.value - before.value) / elapsed_s
            share = 1.0 - exp(-2.0 * pi * self._own.bandwidth_hz * elapsed_s)
            self._smooth_rad_s = self._smooth_rad_s + share * (raw_rad_s - self._smooth_rad_s)
        return shown._replace(value=self._smooth_rad_s)
