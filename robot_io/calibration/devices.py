"""Calibrated devices: each wraps a driver and corrects its readings and commands.

Only here a calibration changes a number between driver and `Measurement` or `Command`. Samples keep their
time and status; NaN stays NaN.
"""

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from robot_io.calibration.file import EncoderCalibration, ForceCalibration, Quantities, TorqueCalibration
from robot_io.examination import Examinable, Finding
from robot_io.interfaces import Component, ForceSensor, JointEncoder, JointTorque
from robot_io.types import FloatArray, Reading, frozen_array

Driver = TypeVar("Driver", bound=Component)


class _Calibrated(Component, Examinable, Generic[Driver]):
    """Forwards lifecycle and examination to the driver."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    def configure(self) -> None:
        self._driver.configure()

    def activate(self) -> None:
        self._driver.activate()

    def deactivate(self) -> None:
        self._driver.deactivate()

    def close(self) -> None:
        self._driver.close()

    def examine(self) -> tuple[Finding, ...]:
        """See `Examinable.examine`; empty for a driver without examination."""
        return self._driver.examine() if isinstance(self._driver, Examinable) else ()

    def tick_wire_s(self) -> float | None:
        return self._driver.tick_wire_s() if isinstance(self._driver, Examinable) else None


class CalibratedForceSensor(_Calibrated[ForceSensor], ForceSensor):
    """Force sensor with force = scale (reading - zero) + curvature (reading - zero)^2."""

    def __init__(self, driver: ForceSensor, calibration: ForceCalibration) -> None:
        super().__init__(driver)
        values = calibration.values
        self._zero, self._scale = values.zero.value, values.scale.value
        self._curvature = values.curvature.value if values.curvature else 0.0

    def read_force(self) -> Reading:
        reading = self._driver.read_force()
        above = reading.value - self._zero
        return reading._replace(value=above * (self._scale + self._curvature * above))


class CalibratedEncoder(_Calibrated[JointEncoder], JointEncoder):
    """Encoder with position = reading + offset; the velocity is unchanged."""

    def __init__(self, driver: JointEncoder, calibration: EncoderCalibration) -> None:
        super().__init__(driver)
        self._offset_rad = _values(calibration.values.offset)

    @property
    def joint_count(self) -> int:
        return self._driver.joint_count

    def read_position(self) -> Reading:
        reading = self._driver.read_position()
        return reading._replace(value=reading.value + self._offset_rad)

    def read_velocity(self) -> Reading:
        return self._driver.read_velocity()


class CalibratedTorque(_Calibrated[JointTorque], JointTorque):
    """Drive with torque = gain reading + offset; its command is (torque - command offset) / gain.

    A command never exceeds the limit, whatever the calibration makes of a torque within it. A zero torque is
    commanded as what the calibration says gives zero.

    Args:
        driver: of the drives.
        calibration: of the torques.
        limit_nm: largest command, shape (n,) [N m].
    """

    def __init__(self, driver: JointTorque, calibration: TorqueCalibration, limit_nm: ArrayLike) -> None:
        super().__init__(driver)
        values = calibration.values
        self._gain = _values(values.gain)
        self._offset_nm = _values(values.offset)
        self._command_offset_nm = _values(values.command_offset)
        self._limit_nm = frozen_array(limit_nm, self._gain.shape, what="torque limit")

    @property
    def joint_count(self) -> int:
        return self._driver.joint_count

    def read_torque(self) -> Reading:
        reading = self._driver.read_torque()
        return reading._replace(value=self._gain * reading.value + self._offset_nm)

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`; argument and return value are true torques."""
        command_nm = (torque_nm - self._command_offset_nm) / self._gain
        staged_nm = self._driver.stage_torque(np.clip(command_nm, -self._limit_nm, self._limit_nm))
        return np.asarray(self._gain * staged_nm + self._command_offset_nm)


def _values(quantities: Quantities) -> FloatArray:
    return frozen_array(quantities.value)
