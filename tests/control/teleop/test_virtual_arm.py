"""The virtual arm follows the hand as another arm's kinematics allow."""

import numpy as np

from control.arm.rigid_body import RigidBody
from control.teleop.virtual_arm import VirtualArm
from robot_io.robot_file import load_robot_file
from tests.control.simulated_arms import ARMS


def test_the_tip_is_where_the_hand_is_and_the_tool_points_down():
    robot_file = load_robot_file(ARMS / "leader" / "leader.yaml")
    body = RigidBody.of_robot(robot_file)
    axis, down = np.array(robot_file.sensor_axis_tip), np.array((0.0, 0.0, -1.0))
    arm = VirtualArm(body, axis, down, np.array(robot_file.home_rad))
    before_rad = arm.position_rad
    for x_m in np.linspace(0.30, 0.45, 40):
        hand = np.array((x_m, 0.0, 0.1))
        arm.follow(hand)
        tip, rotation = body.tip_pose(arm.position_rad)
        np.testing.assert_allclose(tip, hand, atol=1e-9)
        np.testing.assert_allclose(rotation @ axis, down, atol=1e-9)
        assert arm.reached
    assert np.abs(arm.position_rad - before_rad).max() < 1.5  # no turns, and the elbow stays where it was
    there_rad = arm.position_rad
    arm.follow(np.array((3.0, 0.0, 0.1)))
    assert not arm.reached
    np.testing.assert_array_equal(arm.position_rad, there_rad)
