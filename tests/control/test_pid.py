"""PID: what each part does, and that it does not wind up."""

import numpy as np
import pytest

from control.laws.computed_torque import Pid
from robot_io.errors import InputError

DT_S = 0.001


def pid(**changes) -> Pid:
    settings = {"kp": 100.0, "ki": 50.0, "kd": 10.0, "output_limit": 1e9}
    return Pid(2, **(settings | changes))


def test_the_parts_add_up():
    controller = pid()
    error, rate = np.array([0.1, -0.2]), np.array([0.5, 0.0])
    assert controller.step(error, rate, DT_S) == pytest.approx((15.005, -20.01))
    for _ in range(999):
        output = controller.step(error, rate, DT_S)
    assert output == pytest.approx((10.0 + 5.0 + 5.0, -20.0 - 10.0))  # a second of integral


def test_a_disturbance_is_taken_out_completely():
    controller, position, velocity = pid(), np.zeros(2), np.zeros(2)
    disturbance = np.array([3.0, -1.0])
    for _ in range(20_000):
        velocity += (controller.step(-position, -velocity, DT_S) + disturbance) * DT_S
        position += velocity * DT_S
    assert position == pytest.approx(np.zeros(2), abs=1e-6)
    assert controller.integral == pytest.approx(-disturbance, abs=1e-4)


def send_a_mass(push_of) -> tuple[float, float]:
    """A unit mass sent 1 m away: how far it overshoots, and where it is after 20 s."""
    position, velocity, furthest = 0.0, 0.0, 0.0
    for _ in range(20_000):
        velocity += push_of(1.0 - position, -velocity) * DT_S
        position += velocity * DT_S
        furthest = max(furthest, position)
    return furthest - 1.0, position


def test_a_long_saturation_does_not_wind_up():
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


def test_the_integral_stands_still_in_saturation_but_can_come_back():
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


def test_the_derivative_is_filtered():
    controller = pid(kp=0.0, ki=0.0, kd=1.0, derivative_filter_s=0.01)
    outputs = [controller.step(np.zeros(2), np.ones(2), DT_S)[0] for _ in range(100)]
    assert outputs[0] == pytest.approx(1 / 11)
    assert outputs[9] == pytest.approx(1 - (10 / 11) ** 10)
    assert outputs[-1] == pytest.approx(1.0, abs=1e-3)
    noise = np.random.default_rng(0).normal(size=20_000)
    filtered = [controller.step(np.zeros(2), np.full(2, value), DT_S)[0] for value in noise]
    assert np.std(filtered) < 0.3


def test_reset_forgets():
    controller = pid(derivative_filter_s=0.01)
    fresh = controller.step(np.ones(2), np.ones(2), DT_S)
    controller.step(np.ones(2), np.ones(2), DT_S)
    controller.reset()
    assert controller.step(np.ones(2), np.ones(2), DT_S) == pytest.approx(fresh)


@pytest.mark.parametrize("changes", [{"kp": -1.0}, {"output_limit": 0.0}, {"derivative_filter_s": -0.1}])
def test_bad_gains_are_refused(changes):
    with pytest.raises(InputError, match="PID"):
        pid(**changes)
