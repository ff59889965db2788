"""Computed torque on the reference plant: it tracks, and errors die out as designed."""

import numpy as np
import pytest

from control.laws.computed_torque import ComputedTorque
from control.laws.gains import TrackingGains
from control.paths.trajectory import JointMotion, JointMove
from tests.control.probing_runs import TICK_S, plant_above
from tests.control.reference_plant import test_arm

NONE = np.zeros(3)


def follow(plant, controller, motion_at, duration_s: float, push_nm=NONE) -> np.ndarray:
    """Tracking errors, one row a tick, with an unknown torque `push_nm` on the joints."""
    errors = []
    for tick in range(round(duration_s / TICK_S)):
        measurement = plant.measure()
        motion = motion_at(tick * TICK_S)
        torque = controller.step(measurement, motion, NONE, TICK_S)
        plant.advance(torque + push_nm, TICK_S)
        errors.append(motion.position_rad - measurement.joint_position_rad)
    return np.array(errors)


def test_a_fast_move_is_tracked_closely():
    plant = plant_above(height_m=0.2)
    start = plant.position_rad.copy()
    move = JointMove(start, start + np.array([-0.5, 0.6, -0.4]), 2.0, 15.0)
    errors = follow(plant, ComputedTorque(test_arm(), TrackingGains()), move.at, move.duration_s + 0.2)
    assert np.abs(errors).max() < 2e-3
    assert np.abs(errors[-1]).max() < 5e-5


def test_an_error_dies_out_like_the_designed_oscillator_on_every_joint():
    gains = TrackingGains(bandwidth_rad_s=20.0, integral_rate_1_s=0.0, derivative_filter_s=0.0)
    plant = plant_above(height_m=0.2)
    goal = plant.position_rad.copy()
    start_error = np.array([0.02, -0.03, 0.05])
    plant.position_rad = goal - start_error
    still = JointMotion(goal, NONE, NONE)
    errors = follow(plant, ComputedTorque(test_arm(), gains), lambda _: still, 0.3)
    time_s = np.arange(len(errors)) * TICK_S
    critically_damped = (1.0 + 20.0 * time_s) * np.exp(-20.0 * time_s)
    assert errors == pytest.approx(np.outer(critically_damped, start_error), abs=0.03 * 0.05)


def test_a_constant_disturbance_is_taken_out():
    plant = plant_above(height_m=0.2)
    still = JointMotion(plant.position_rad.copy(), NONE, NONE)
    push = np.array([1.0, -0.5, 0.2])
    errors = follow(plant, ComputedTorque(test_arm(), TrackingGains()), lambda _: still, 2.0, push)
    assert np.abs(errors).max() > 1e-3  # it was felt
    assert np.abs(errors[-1]).max() < 2e-5


def test_reset_forgets_the_disturbance():
    plant = plant_above(height_m=0.2)
    still = JointMotion(plant.position_rad.copy(), NONE, NONE)
    controller = ComputedTorque(test_arm(), TrackingGains())
    follow(plant, controller, lambda _: still, 0.5, np.array([1.0, -0.5, 0.2]))
    controller.reset()
    measurement = plant_above(height_m=0.2).measure()
    torque = controller.step(measurement, still, NONE, TICK_S)
    assert torque == pytest.approx(test_arm().gravity(still.position_rad), abs=1e-9)
