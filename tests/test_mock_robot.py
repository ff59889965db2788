"""The mock arm moves as its URDF states."""

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from tests.control.reference_plant import forward_dynamics
from tests.mock_robot import URDF, MockPlant

POSE = np.array([-0.9, 1.2, 0.7])


@pytest.fixture
def body():
    return RigidBody.from_urdf(URDF, "tip")


def test_engine_matches_acceleration_and_kinematics_of_the_urdf(body):
    torque = np.array([0.7, -0.4, 0.2])
    plant = MockPlant(POSE, 1000.0, 20.0)
    plant.surface_height_m, plant.torque_nm = -9.0, torque
    plant.advance(1e-3)
    expected = forward_dynamics(body, POSE, np.zeros(3), torque)
    np.testing.assert_allclose(plant.velocity_rad_s / 1e-3, expected, rtol=1e-3)
    assert MockPlant(POSE, 1000.0, 20.0).tip_height_m == pytest.approx(body.tip_pose(POSE)[0][2], abs=1e-9)


def test_lifted_tip_moves_the_joints_according_to_the_urdf(body):
    plant = MockPlant(POSE, 1000.0, 20.0)
    plant.surface_height_m, plant.hand_force_n = -9.0, 2.0
    plant.advance(1e-3)
    torque = body.tip_jacobian(POSE)[:3].T @ np.array([0.0, 0.0, 2.0])
    expected = forward_dynamics(body, POSE, np.zeros(3), torque)
    np.testing.assert_allclose(plant.velocity_rad_s / 1e-3, expected, rtol=1e-3)


def test_tip_comes_to_rest_at_force_balance(body):
    """Pressed down with J^T F and damped joints, the depth at rest is F / k, and the sensor feels F."""
    plant = MockPlant(np.array([-1.275, 1.391, 1.455]), 2000.0, 50.0)
    plant.surface_height_m = plant.tip_height_m - 0.002
    for tick in range(1, 4001):
        jacobian = body.tip_jacobian(plant.position_rad)[:3]
        plant.torque_nm = (
            jacobian.T @ np.array([0.0, 0.0, -8.0]) - np.array([6.0, 3.0, 0.6]) * plant.velocity_rad_s
        )
        plant.advance(tick * 1e-3)
    depth_m = plant.surface_height_m - plant.tip_height_m
    assert depth_m == pytest.approx(8.0 / 2000.0, rel=0.02)
    assert plant.compression_n == pytest.approx(8.0 * np.sin(plant.angle_rad[2]), rel=0.02)


def test_surface_never_pulls():
    plant = MockPlant(np.array([-1.275, 1.391, 1.455]), 10.0, 200.0)
    plant.surface_height_m = plant.tip_height_m + 0.01
    plant.rate_rad_s = np.array([-5.0, 0.0, 0.0])  # leaves fast
    assert plant.lift_n == 0.0
