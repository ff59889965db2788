"""A robot that does nothing and costs nothing, so that only the loop and the machine are measured."""

import numpy as np

from control.loop.phases import Phase
from control.loop.task import TaskOutput
from robot_io.clock import Clock
from robot_io.guard import Guard, Limits, SafeState
from robot_io.interfaces import ForceSensor, JointEncoder, JointTorque
from robot_io.robot import Robot
from robot_io.types import Command, FloatArray, Measurement, Reading

JOINTS = 3
ZEROS = np.zeros(JOINTS)
DOWN = np.array([0.0, 0.0, -1.0])
OUTPUT = TaskOutput(Command(ZEROS), ZEROS, ZEROS, ZEROS, ZEROS, DOWN, 0.0, Phase.IDLE)


class IdleArm(JointEncoder, JointTorque, ForceSensor):
    """All three devices at once: at rest, without torque and force, sampled at the moment of reading."""

    joint_count = JOINTS

    def __init__(self, clock: Clock) -> None:
        self.clock = clock

    def read_position(self) -> Reading:
        """Zeros [rad]."""
        return Reading(ZEROS, self.clock.now_s())

    read_velocity = read_torque = read_position

    def read_force(self) -> Reading:
        """Zero [N]."""
        return Reading(ZEROS[:1], self.clock.now_s())

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """Takes anything."""
        return torque_nm


class IdleTask:
    """Wants nothing, for a number of ticks."""

    def __init__(self, ticks: int) -> None:
        self.left = ticks

    def start(self, measurement: Measurement) -> None:
        """See `Task.start`."""

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """See `Task.step`."""
        self.left -= 1
        if self.left > 0:
            return OUTPUT
        return TaskOutput(Command(ZEROS), ZEROS, ZEROS, ZEROS, ZEROS, DOWN, 0.0, Phase.IDLE, done=True)


def idle_robot(clock: Clock) -> tuple[Robot, Guard]:
    """The robot, in state NEW, and a guard that looks at everything and minds nothing."""
    arm = IdleArm(clock)
    per_joint = (1.0,) * JOINTS
    limits = Limits(
        torque_nm=per_joint,
        torque_rate_nm_s=per_joint,
        position_min_rad=(-1.0,) * JOINTS,
        position_max_rad=per_joint,
        velocity_rad_s=per_joint,
        force_n=1.0,
        tracking_rad=per_joint,
        encoder_age_s=1.0,
        torque_age_s=1.0,
        force_age_s=1.0,
    )
    guard = Guard(limits, SafeState(damping_nms_rad=per_joint, stop_time_s=0.0), JOINTS)
    return Robot(arm, arm, arm, {}, clock, "idle"), guard
