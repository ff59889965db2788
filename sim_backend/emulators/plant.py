"""What stands behind all emulated wires of one arm: the simulated world, one motor at a time."""

from dataclasses import dataclass

from robot_io.robot_file import RobotFile
from robot_io.types import Status
from sim_backend.hooks import NO_EFFECTS, HiddenEffects
from sim_backend.scenario import Scenario
from sim_backend.world import world_of

_REST_SHARE = 0.04  # of a joint's torque limit


@dataclass(frozen=True, slots=True)
class JointState:
    """What a motor's own sensors show of its joint."""

    position_rad: float  # joint angle [rad]
    velocity_rad_s: float  # its rate [rad/s]
    torque_nm: float  # torque at the joint [N m]


class Plant:
    """An arm in a simulated world, as its motors and its force sensor see it.

    It stands on its rest, and rubs there, until a motor first exerts 4 % of its limit in the robot file: what
    a driver tries out at activation moves nothing. Its sensors are as good as those of the direct simulation.
    It begins at `start_s` on the bench's clock [s]. Not safe for threads: one bench owns it.
    """

    def __init__(
        self, robot_file: RobotFile, scenario: Scenario, start_s: float, effects: HiddenEffects = NO_EFFECTS
    ) -> None:
        self.world = world_of(robot_file, scenario, effects, start_s)
        self.world.held = True
        self._torque_nm = [0.0] * self.world.joint_count
        self._rest_nm = [_REST_SHARE * limit for limit in robot_file.limits.torque_nm]
        self._joints = [JointState(angle, 0.0, 0.0) for angle in robot_file.home_rad]
        # The newest, positive in compression [N], and how far to trust it; None before the first.
        self.force: tuple[float, Status] | None = None

    def set_torque(self, joint: int, torque_nm: float) -> None:
        """What the motor of `joint` (from 0) exerts from now on [N m]."""
        if torque_nm == self._torque_nm[joint]:
            return
        if abs(torque_nm) > self._rest_nm[joint]:
            self.world.held = False
        self._torque_nm[joint] = torque_nm
        self.world.set_torque(self._torque_nm)

    def advance_to(self, time_s: float) -> None:
        """Let physics pass up to `time_s` [s] on the bench's clock, and sample all sensors."""
        world = self.world
        world.advance_to(time_s)
        motion, torque = world.encoder.read(time_s), world.torque_sensor.read(time_s)
        if motion is not None and torque is not None:
            n = world.joint_count
            self._joints = [
                JointState(motion.value[i], motion.value[n + i], torque.value[i]) for i in range(n)
            ]
        force = world.force_sensor.read(time_s)
        if force is not None:
            self.force = (force.value[0], force.status)

    def joint(self, joint: int) -> JointState:
        """The newest sample of `joint` (from 0)."""
        return self._joints[joint]

    def close(self) -> None:
        """End the world. Can be called again."""
        self.world.close()
