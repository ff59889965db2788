"""Drivers of the simulated robot, which a robot file names like other drivers."""

from collections.abc import Mapping

import numpy as np

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.joint_bus import JointBus, joint_drivers
from palpate.robot_io.errors import LifecycleError
from palpate.robot_io.files.file_model import FileModel, input_error
from palpate.robot_io.interfaces import ForceSensor
from palpate.robot_io.types import FloatArray, Reading, Status, clip
from palpate.sim_backend.scenario import Scenario, load_scenario
from palpate.sim_backend.sensors import SensorSample, quantize
from palpate.sim_backend.world import World, world_of

_REST_RAD, _REST_RAD_S = 0.01, 0.1  # an arm closer and slower than this is on its rest


class SimulatedBusSettings(FileModel):
    """Settings of the simulated world in a robot file."""

    # Name of a shipped scenario, path of a scenario file, or the scenario itself.
    scenario: str | dict[str, object] = "default"


class SimulatedBus(JointBus):
    """Bus that connects to a simulated world.

    On a simulated clock the world advances with the clock; on any other it catches up at each poll and flush.
    Before its first activation the arm is supported by its rest, and again after it is deactivated
    there. Readings have the scenario's errors, torques also its resolution; their range is the URDF's effort
    limit.

    Attributes:
        scenario: scenario of the world; `use_scenario` changes it until the robot is configured.
        force: newest force, shape (1,) [N].
    """

    name = "pybullet"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(SimulatedBusSettings, settings)
        if isinstance(validated.scenario, Mapping) and validated.scenario.get("hidden"):
            problem = "belongs in a scenario file: a session contains the robot file for all to read"
            raise input_error(context.robot_file.document, (*context.section, "scenario", "hidden"), problem)
        self._clock = context.clock
        self._robot_file, self._joint_count = context.robot_file, context.robot_file.joint_count
        self._world: World | None = None
        self._staged_torque_nm: list[float] | None = None
        self._rest_rad: FloatArray | None = None
        self._powered = False
        self.position = self.velocity = self.torque = _reading(None, self.joint_count)
        self.force = _reading(None, 1)
        self.scenario = load_scenario(validated.scenario, context.robot_file.path.parent)
        if isinstance(self._clock, SimulatedClock):
            self._clock.subscribe(lambda time_s: self._world.advance_to(time_s) if self._world else None)

    @property
    def joint_count(self) -> int:
        return self._joint_count

    def use_scenario(self, scenario: Scenario) -> None:
        """Replace the robot file's scenario.

        Args:
            scenario: new scenario.

        Raises:
            LifecycleError: the world already exists.
        """
        if self._world is not None:
            raise LifecycleError("a scenario can only be chosen before the robot is configured")
        self.scenario = scenario

    @property
    def world(self) -> World:
        """The simulated world, for access to its object and true values.

        Raises:
            LifecycleError: the robot is not configured, or closed.
        """
        if self._world is None:
            raise LifecycleError("the simulated world exists only between configure and close")
        return self._world

    def configure(self) -> None:
        """Build the world, with the arm at home and at rest.

        Raises:
            InputError: the physics engine cannot load the URDF, or it does not fit the robot file.
        """
        self._world = world_of(self._robot_file, self.scenario, start_s=self._clock.now_s())
        self._world.held = True

    def activate(self) -> None:
        """Release the arm from its rest."""
        if self.world.held:
            self._rest_rad = self.world.truth().joint_position_rad
        self.world.held = False

    def deactivate(self) -> None:
        """Switch the torque off; the rest supports the arm again if the arm is there."""
        self.power_off()
        if self._world is not None and self._rest_rad is not None:
            truth = self._world.truth()
            is_there = np.abs(truth.joint_position_rad - self._rest_rad).max() < _REST_RAD
            is_still = np.abs(truth.joint_velocity_rad_s).max() < _REST_RAD_S
            self._world.held = self._world.held or bool(is_there and is_still)

    def close(self) -> None:
        """Close the world."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; a simulated world is never late."""
        world, now_s = self.world, self._clock.now_s()
        world.advance_to(now_s)
        n = self.joint_count
        motion, sampled_at_s, status, _ = _reading(world.encoder.read(now_s), 2 * n)
        self.position = Reading(motion[:n], sampled_at_s, status)
        self.velocity = Reading(motion[n:], sampled_at_s, status)
        self.torque = _reading(world.torque_sensor.read(now_s), n)
        self.force = _reading(world.force_sensor.read(now_s), 1)

    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointBus.stage`; rounded to the drives' steps, then clipped to the URDF's effort limits."""
        if not self._powered:
            raise LifecycleError("the drives are off; activate them before the first command")
        step_nm, limits_nm = self.scenario.sensors.torque.command_resolution_nm, self.world.torque_limit_nm
        pairs = zip(quantize(torque_nm.tolist(), step_nm), limits_nm, strict=True)
        self._staged_torque_nm = [clip(torque, -limit, limit) for torque, limit in pairs]
        return np.array(self._staged_torque_nm)

    def power_on(self) -> None:
        self._powered = True

    def power_off(self) -> None:
        self._powered = False
        self._staged_torque_nm = None
        if self._world is not None:
            self._world.advance_to(self._clock.now_s())
            self._world.set_torque([0.0] * self._world.joint_count)

    def flush(self, deadline_s: float) -> None:
        """Apply the staged torques from now on, once the world has caught up with the clock."""
        if self._staged_torque_nm is not None:
            self.world.advance_to(self._clock.now_s())
            self.world.set_torque(self._staged_torque_nm)
            self._staged_torque_nm = None


def _reading(sample: SensorSample | None, size: int) -> Reading:
    """Convert a sample of `size` values, which are NaN if none has arrived."""
    if sample is None:
        return Reading(np.full(size, np.nan), -np.inf, Status.STALE)
    return Reading(np.array(sample.value), sample.sampled_at_s, sample.status)


SimEncoder, SimTorque = joint_drivers(SimulatedBus, "sim")


class SimForce(ForceSensor):
    """Contact force of the world, with the scenario's errors."""

    name = "sim_force"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        context.settings_as(FileModel, settings)
        self._bus = context.bus_as(SimulatedBus)

    def read_force(self) -> Reading:
        return self._bus.force
