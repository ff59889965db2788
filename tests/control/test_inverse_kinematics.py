"""Closed-form inverse kinematics, checked with forward kinematics."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from palpate.control.arm.inverse_kinematics import Elbow, PlanarArm
from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from tests.control.reference_plant import DOWN, TOOL_AXIS_TIP, arm_urdf, test_arm

ARMS = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"


def tilted_arm() -> RigidBody:
    """Offsets in every angle, an axis turned over, and a plane that is no coordinate plane."""
    origins = (
        *('xyz="0.1 0.2 0.3" rpy="0.4 0.3 1.1"', 'xyz="0.3 0.02 0.1" rpy="0 0.3 0"'),
        *('xyz="0.2 0 -0.1" rpy="0 -0.4 0"', 'xyz="0.1 0 0.05" rpy="0 0.2 0"'),
    )
    return RigidBody.from_urdf(arm_urdf(origins, axes=("0 1 0", "0 -1 0", "0 1 0")), "tip")


BODIES = {
    "reference": test_arm(),
    "tilted": tilted_arm(),
    **{path.stem: RigidBody.from_urdf(path, "tip") for path in ARMS.glob("*/*.urdf")},
}
joints = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@pytest.mark.parametrize("name", BODIES)
@given(joints)
def test_both_solutions_reach_any_reachable_pose(name, position):
    body = BODIES[name]
    arm = PlanarArm(body, TOOL_AXIS_TIP)
    tip, rotation = body.tip_pose(np.array(position))
    tool = rotation @ TOOL_AXIS_TIP
    assume(arm.solve(tip, tool, Elbow.POSITIVE).elbow_sine > 1e-3)
    for elbow in Elbow:
        solution = arm.solve(tip, tool, elbow)
        reached, turned = body.tip_pose(solution.position_rad)
        assert reached == pytest.approx(tip, abs=1e-9)
        assert turned @ TOOL_AXIS_TIP == pytest.approx(tool, abs=1e-9)
        assert arm.elbow_of(solution.position_rad) is elbow
        assert (np.abs(solution.position_rad) <= math.pi).all()
    same = arm.solve(tip, tool, arm.elbow_of(np.array(position))).position_rad
    turns = (same - position) / math.tau
    assert turns == pytest.approx(np.round(turns), abs=1e-7)


def test_link_lengths_are_read_from_the_arm():
    assert PlanarArm(test_arm(), TOOL_AXIS_TIP).lengths_m == pytest.approx((0.32, 0.28, 0.12))


def test_unreachable_target_names_the_reach_and_its_edge_is_near_singular():
    arm = PlanarArm(test_arm(), TOOL_AXIS_TIP)
    with pytest.raises(InputError, match=r"wrist is 0\.8089 m .* reaches 0\.0400 to 0\.6000 m"):
        arm.solve(np.array([0.8, 0.0, 0.0]), DOWN, Elbow.POSITIVE)
    with pytest.raises(InputError, match="out of reach"):  # too near: inside the inner circle
        arm.solve(np.array([0.01, 0.0, -0.12]), DOWN, Elbow.POSITIVE)
    arm = PlanarArm(test_arm(), TOOL_AXIS_TIP)
    assert arm.solve(np.array([0.5999, 0.0, -0.12]), DOWN, Elbow.POSITIVE).near_singular
    assert not arm.solve(np.array([0.4, 0.0, 0.0]), DOWN, Elbow.POSITIVE).near_singular


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ({"axes": ("0 1 0", "0 1 0", "0 1 0.2")}, "axis of 'joint_3' is not parallel to that of 'joint_1'"),
        ({"kinds": ("revolute", "prismatic", "revolute")}, "3 revolute joints; this arm has: revolute, pris"),
        ({"origins": ('xyz="0 0 0"', 'xyz="0.3 0 0"', 'xyz="0 0 0"', 'xyz="0.1 0 0"')}, "above 0"),
    ],
)
def test_other_arms_are_refused(arm, message):
    with pytest.raises(InputError, match=message):
        PlanarArm(RigidBody.from_urdf(arm_urdf(**arm), "tip"), TOOL_AXIS_TIP)
