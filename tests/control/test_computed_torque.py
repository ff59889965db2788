"""Computed torque on the reference plant: tracking and error dynamics."""

import numpy as np
import pytest

from palpate.control.laws.computed_torque import ComputedTorque, Pid
from palpate.control.laws.gains import Gains, TrackingGains, gains_of
from palpate.control.paths.trajectory import JointMotion, JointMove
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file, parse_robot_file
from tests.control.probing_runs import TICK_S, plant_above
from tests.control.reference_plant import test_arm
from tests.control.simulated_arms import ARMS
from tests.mock_robot import ROBOT_YAML

NONE = np.zeros(3)
DT_S = 0.001


def follow(plant, controller, motion_at, duration_s: float, push_nm=NONE) -> np.ndarray:
    """Tracking errors, one row a tick, with an unknown torque `push_nm` on the joints."""
    errors = []
    for tick in range(round(duration_s / TICK_S)):
        measurement = plant.measure()
        motion = motion_at(tick * TICK_S)
        plant.advance(controller.step(measurement, motion, NONE, TICK_S) + push_nm, TICK_S)
        errors.append(motion.position_rad - measurement.joint_position_rad)
    return np.array(errors)


def test_fast_move_is_tracked_closely():
    plant = plant_above(height_m=0.2)
    start = plant.position_rad.copy()
    move = JointMove(start, start + np.array([-0.5, 0.6, -0.4]), 2.0, 15.0)
    errors = follow(plant, ComputedTorque(test_arm(), TrackingGains()), move.at, move.duration_s + 0.2)
    assert np.abs(errors).max() < 2e-3
    assert np.abs(errors[-1]).max() < 5e-5


def test_error_decays_like_the_designed_oscillator_on_every_joint():
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


def test_constant_disturbance_is_rejected():
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
    torque = controller.step(plant_above(height_m=0.2).measure(), still, NONE, TICK_S)
    assert torque == pytest.approx(test_arm().gravity(still.position_rad), abs=1e-9)


def pid(**changes) -> Pid:
    settings = {"kp": 100.0, "ki": 50.0, "kd": 10.0, "output_limit": 1e9}
    return Pid(2, **(settings | changes))


def test_parts_add_up():
    controller = pid()
    error, rate = np.array([0.1, -0.2]), np.array([0.5, 0.0])
    assert controller.step(error, rate, DT_S) == pytest.approx((15.005, -20.01))
    for _ in range(999):
        output = controller.step(error, rate, DT_S)
    assert output == pytest.approx((10.0 + 5.0 + 5.0, -20.0 - 10.0))  # a second of integral


def send_a_mass(push_of) -> tuple[float, float]:
    """A unit mass sent 1 m away: how far it overshoots, and where it is after 8 s."""
    position, velocity, furthest = 0.0, 0.0, 0.0
    for _ in range(8_000):
        velocity += push_of(1.0 - position, -velocity) * DT_S
        position += velocity * DT_S
        furthest = max(furthest, position)
    return furthest - 1.0, position


def test_long_saturation_does_not_wind_up():
    controller = Pid(1, kp=100.0, ki=100.0, kd=20.0, output_limit=2.0)
    collected = 0.0

    def winding_up(error: float, rate: float) -> float:
        nonlocal collected
        collected += 100.0 * error * DT_S
        return float(np.clip(100.0 * error + collected + 20.0 * rate, -2.0, 2.0))

    ours, arrived = send_a_mass(
        lambda error, rate: controller.step(np.array([error]), np.array([rate]), DT_S)[0]
    )
    assert arrived == pytest.approx(1.0, abs=1e-3)
    theirs, _ = send_a_mass(winding_up)
    assert ours < 0.5 * theirs


def test_integral_is_frozen_in_saturation_but_can_return():
    controller = pid(output_limit=5.0)
    for _ in range(1000):
        output = controller.step(np.array([1.0, 0.001]), np.zeros(2), DT_S)
    assert output == pytest.approx((5.0, 0.15))
    assert controller.integral == pytest.approx((0.0, 0.05))
    for _ in range(100):
        controller.step(np.array([-1.0, 0.0]), np.zeros(2), DT_S)
    assert controller.integral[0] == pytest.approx(0.0)  # saturated the other way
    for _ in range(100):
        controller.step(np.array([-0.01, 0.0]), np.zeros(2), DT_S)
    assert controller.integral[0] == pytest.approx(-0.05)


def test_derivative_is_filtered():
    controller = pid(kp=0.0, ki=0.0, kd=1.0, derivative_filter_s=0.01)
    outputs = [controller.step(np.zeros(2), np.ones(2), DT_S)[0] for _ in range(100)]
    assert outputs[0] == pytest.approx(1 / 11)
    assert outputs[9] == pytest.approx(1 - (10 / 11) ** 10)
    assert outputs[-1] == pytest.approx(1.0, abs=1e-3)
    noise = np.random.default_rng(0).normal(size=20_000)
    filtered = [controller.step(np.zeros(2), np.full(2, value), DT_S)[0] for value in noise]
    assert np.std(filtered) < 0.3


def test_reset_forgets_the_state():
    controller = pid(derivative_filter_s=0.01)
    fresh = controller.step(np.ones(2), np.ones(2), DT_S)
    controller.step(np.ones(2), np.ones(2), DT_S)
    controller.reset()
    assert controller.step(np.ones(2), np.ones(2), DT_S) == pytest.approx(fresh)


def file_with(gains: str):
    return parse_robot_file(ROBOT_YAML + gains, "arm.yaml")


def test_missing_gains_get_defaults():
    assert gains_of(file_with("")) == Gains()
    gains = gains_of(file_with("gains: {contact: {mass_kg: 2.5}}\n"))
    assert gains.contact.mass_kg == 2.5
    assert gains.contact.latency_s == Gains().contact.latency_s
    assert gains.tracking == Gains().tracking


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{contact: {mas_kg: 2}}", r"arm.yaml line \d+, gains.contact.mas_kg: .*did you mean 'mass_kg'"),
        ("{contact: {mass_kg: -2}}", r"gains.contact.mass_kg: .*greater than 0 \(is -2\)"),
        ("{tracking: {bandwidth_rad_s: 20, integral_rate_1_s: 15}}", r"gains.tracking: .*too fast"),
        ("{touch: {debounce_samples: 0}}", "gains.touch.debounce_samples"),
        ("{contact: {loading_aim: 0.5}}", "gains.contact.loading_aim"),
    ],
)
def test_invalid_gain_names_file_line_and_key(text, message):
    with pytest.raises(InputError, match=message):
        gains_of(file_with(f"gains: {text}\n"))


@pytest.mark.parametrize("name", ["leader", "follower"])
def test_shipped_arms_have_valid_gains(name):
    gains_of(load_robot_file(ARMS / name / f"{name}.yaml"))
