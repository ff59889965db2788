"""Encoders, drives and force sensor of the simulated arm, on a `simulated_bus`."""

from collections.abc import Mapping

import numpy as np

from robot_io.clip import clip
from robot_io.driver import DriverContext
from robot_io.errors import LifecycleError
from robot_io.files.file_model import FileModel
from robot_io.interfaces import ForceSensor, JointEncoder, JointTorque
from robot_io.types import FloatArray, Reading, Status
from sim_backend.drivers.simulated_bus import SimulatedBus
from sim_backend.sensors import Sample
from sim_backend.sensors.sampling import quantise


def reading_of(sample: Sample | None, part: slice, size: int) -> Reading:
    """A part of `sample`, or NaN of shape (`size`,) from minus infinity where none has arrived yet."""
    if sample is None:
        return Reading(np.full(size, np.nan), -np.inf, Status.STALE)
    return Reading(np.array(sample.value[part]), sample.sampled_at_s, sample.status)


class SimEncoder(JointEncoder):
    """Positions and velocities out of the world of a `pybullet` bus; the scenario says how good they are."""

    name = "sim_encoder"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(SimulatedBus)
        self._joint_count = context.robot_file.joint_count

    @property
    def joint_count(self) -> int:
        return self._joint_count

    def read_position(self) -> Reading:
        return reading_of(self._bus.encoder_sample, slice(0, self._joint_count), self._joint_count)

    def read_velocity(self) -> Reading:
        return reading_of(self._bus.encoder_sample, slice(self._joint_count, None), self._joint_count)


class SimTorque(JointTorque):
    """Torque-controlled drives in the world of a `pybullet` bus.

    Their range is the URDF's effort limit; their resolution and the quality of what they measure are the
    scenario's.
    """

    name = "sim_torque"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(SimulatedBus)
        self._joint_count = context.robot_file.joint_count
        self._resolution_nm = 0.0
        self._active = False

    @property
    def joint_count(self) -> int:
        return self._joint_count

    def configure(self) -> None:
        self._resolution_nm = self._bus.scenario.sensors.torque.command_resolution_nm

    def activate(self) -> None:
        """Torque on, at zero until the first command."""
        self._active = True

    def deactivate(self) -> None:
        """Torque off."""
        self._active = False
        self._bus.torque_off()

    def read_torque(self) -> Reading:
        return reading_of(self._bus.torque_sample, slice(None), self._joint_count)

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`. LifecycleError: the drives are off."""
        if not self._active:
            raise LifecycleError("the drives are off: activate them before the first command")
        resolution_nm, limits_nm = self._resolution_nm, self._bus.world.torque_limit_nm
        wanted = zip(quantise(torque_nm.tolist(), resolution_nm), limits_nm, strict=True)
        sent = np.array([clip(torque, -limit, limit) for torque, limit in wanted])
        self._bus.stage(sent)
        return sent


class SimForce(ForceSensor):
    """The contact force out of the world of a `pybullet` bus; the scenario says how good it is."""

    name = "sim_force"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(SimulatedBus)

    def read_force(self) -> Reading:
        return reading_of(self._bus.force_sample, slice(None), 1)
