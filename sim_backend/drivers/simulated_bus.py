"""The bus of the simulated robot: it owns the world, and brings samples from it and torques to it."""

from collections.abc import Mapping

import numpy as np

from robot_io.clock import SimulatedClock
from robot_io.driver import DriverContext
from robot_io.errors import LifecycleError
from robot_io.files.file_model import FileModel, input_error
from robot_io.interfaces import Bus
from robot_io.types import FloatArray
from sim_backend.scenario import Scenario, load_scenario
from sim_backend.sensors import Sample
from sim_backend.world import World, world_of

_REST_RAD, _REST_RAD_S = 0.01, 0.1  # nearer and slower than this the arm is on its rest


class SimulatedBusSettings(FileModel):
    """What the robot file says about the world."""

    # Name of a shipped scenario, path of a scenario file, or the scenario itself.
    scenario: str | dict[str, object] = "default"


class SimulatedBus(Bus):
    """A simulated world in place of a wire.

    On a simulated clock the world moves whenever the clock does; on any other it catches up at each poll and
    flush. Until it is activated for the first time the arm stands on its rest instead of falling, and again
    when it is deactivated there.

    Attributes:
        scenario: what the world will be; `use_scenario` changes it until the robot is configured.
        encoder_sample: positions and velocities (2n) of the last poll, or None before the first has arrived.
        torque_sample: torques (n) of the last poll, or None.
        force_sample: force (1) of the last poll, or None.
    """

    name = "pybullet"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(SimulatedBusSettings, settings)
        if isinstance(own.scenario, Mapping) and own.scenario.get("hidden"):
            problem = "belongs in a scenario file: a session keeps the robot file, for everybody to read"
            raise input_error(context.robot_file.document, (*context.section, "scenario", "hidden"), problem)
        self._clock = context.clock
        self._robot_file = context.robot_file
        self._world: World | None = None
        self._staged_torque_nm: FloatArray | None = None
        self._rest_rad: FloatArray | None = None
        self.encoder_sample: Sample | None = None
        self.torque_sample: Sample | None = None
        self.force_sample: Sample | None = None
        self.scenario = load_scenario(own.scenario, context.robot_file.path.parent)
        if isinstance(self._clock, SimulatedClock):
            self._clock.subscribe(self._advance_to)

    def use_scenario(self, scenario: Scenario) -> None:
        """Take this scenario instead of the robot file's. LifecycleError: the world exists already."""
        if self._world is not None:
            raise LifecycleError("a scenario can only be chosen before the robot is configured")
        self.scenario = scenario

    @property
    def world(self) -> World:
        """The world, for its object and its truth. LifecycleError: the robot is not configured, or closed."""
        if self._world is None:
            raise LifecycleError("the simulated world exists from configure to close")
        return self._world

    def configure(self) -> None:
        """Build the world, with the arm at home and at rest.

        InputError: the physics engine cannot load the URDF, or it does not fit the robot file.
        """
        self._world = world_of(self._robot_file, self.scenario, start_s=self._clock.now_s())
        self._world.held = True

    def activate(self) -> None:
        """Let the arm off its rest."""
        if self.world.held:
            self._rest_rad = self.world.truth().joint_position_rad
        self.world.held = False

    def deactivate(self) -> None:
        """See `torque_off`; where its rest is, the arm stands on it again."""
        self.torque_off()
        if self._world is not None and self._rest_rad is not None:
            truth = self._world.truth()
            is_there = np.abs(truth.joint_position_rad - self._rest_rad).max() < _REST_RAD
            is_still = np.abs(truth.joint_velocity_rad_s).max() < _REST_RAD_S
            self._world.held = self._world.held or bool(is_there and is_still)

    def close(self) -> None:
        """End the world."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def poll(self, deadline_s: float) -> None:
        """See `Bus.poll`; a simulated world is never late."""
        world, now_s = self.world, self._clock.now_s()
        world.advance_to(now_s)
        self.encoder_sample = world.encoder.read(now_s)
        self.torque_sample = world.torque_sensor.read(now_s)
        self.force_sample = world.force_sensor.read(now_s)

    def stage(self, torque_nm: FloatArray) -> None:
        """Keep torques (n) [N m] for the next flush."""
        self._staged_torque_nm = torque_nm

    def torque_off(self) -> None:
        """Take the torque off all drives at once, and drop a command that is staged."""
        self._staged_torque_nm = None
        if self._world is not None:
            self._world.advance_to(self._clock.now_s())
            self._world.set_torque(np.zeros(self._world.joint_count))

    def flush(self, deadline_s: float) -> None:
        if self._staged_torque_nm is not None:
            self.world.advance_to(self._clock.now_s())
            self.world.set_torque(self._staged_torque_nm)
            self._staged_torque_nm = None

    def _advance_to(self, time_s: float) -> None:
        if self._world is not None:
            self._world.advance_to(time_s)
