"""Admittance control on a one-dimensional object, from the softest to the stiffest."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.control.laws.force_laws import (
    Admittance,
    Compliance,
    QuickEstimator,
    loading_acceleration,
    scheduled_admittance,
)
from palpate.control.laws.gains import ContactGains

DT_S = 0.001
GAINS = ContactGains()
objects = st.tuples(st.floats(100.0, 10_000.0), st.floats(0.0, 200.0))
guessed_wrong = st.floats(0.7, 1.5)


def press(compliance, law, duration_s: float, speed_m_s: float = 0.0, delay: int = 1):
    """Depth, speed and force over time; the force that the law sees is `delay` ticks old."""
    stiffness, damping = compliance
    depth, speed = 0.0, speed_m_s
    seen, rows = [0.0] * delay, []
    for _ in range(round(duration_s / DT_S)):
        force = max(stiffness * depth + damping * speed, 0.0)
        seen.append(force)
        speed += law(seen[-1 - delay], speed) * DT_S
        depth += speed * DT_S
        rows.append((depth, speed, force))
    return np.array(rows)


@given(objects, guessed_wrong, guessed_wrong)
def test_force_is_reached_and_held_within_a_second_or_the_object_time_constant(real, k_error, c_error):
    admittance = scheduled_admittance(Compliance(real[0] * k_error, real[1] * c_error), GAINS)
    rows = press(real, lambda force, speed: admittance.acceleration(10.0 - force, speed, DT_S), 3.0)
    force = rows[:, 2]
    # A soft and heavily damped object creeps: what is left then is the share of the virtual damping.
    creep_n = 10.0 * admittance.damping_n_s_m / (admittance.damping_n_s_m + real[1])
    creeping_s = (real[1] + admittance.damping_n_s_m) / real[0]
    allowed_n = 0.2 + 1.2 * creep_n * math.exp(-1.0 / creeping_s)
    assert np.abs(force[1000:] - 10.0).max() < allowed_n
    assert force.max() < 10.5
    assert abs(force[-1] - 10.0) < 0.2 + creep_n * math.exp(-3.0 / creeping_s)


def test_admittance_matches_its_differential_equation_and_is_stable():
    admittance, speed = Admittance(2.0, 50.0), 0.0
    for _ in range(round(0.04 / 1e-5)):
        speed += admittance.acceleration(10.0, speed, 1e-5) * 1e-5
    assert speed == pytest.approx(10.0 / 50.0 * (1.0 - math.exp(-1.0)), rel=1e-3)
    admittance = Admittance(1.0, 1e5)
    speed = 1.0
    for _ in range(10):
        speed += admittance.acceleration(0.0, speed, DT_S) * DT_S
        assert 0.0 <= speed < 1.0


def load(real, guess, speed_m_s):
    def law(force, speed):
        room = GAINS.loading_aim * 10.0 - (force - guess.damping_n_s_m * speed)
        return loading_acceleration(speed, speed_m_s, room, guess, GAINS)

    return press(real, law, 1.0 + 10.0 / (real[0] * speed_m_s) + 8.0 * real[1] / real[0], speed_m_s)


@given(objects, st.floats(0.01, 0.05))
def test_loading_reaches_the_limit_within_five_percent(real, speed_m_s):
    rows = load(real, Compliance(*real), speed_m_s)
    force = rows[:, 2]
    assert force[20:].max() <= 10.5
    assert force[-1] > 9.3
    assert rows[0, 1] == pytest.approx(speed_m_s, rel=0.1)


@pytest.mark.parametrize(("stiffness", "speed_m_s", "share"), [(500.0, 0.15, 0.85), (7100.0, 0.05, 0.6)])
def test_loading_keeps_the_set_speed_for_most_of_the_way(stiffness, speed_m_s, share):
    rows = load((stiffness, 0.0), Compliance(stiffness, 0.0), speed_m_s)
    assert rows[rows[:, 1] > 0.95 * speed_m_s][:, 2].max() > share * 9.8


def test_force_far_above_the_limit_yields_at_the_hardest():
    spike = loading_acceleration(0.15, 0.15, 8.0, Compliance(500.0, 200.0), GAINS)
    assert -GAINS.yielding_m_s2 <= spike <= -20.0
    crash = loading_acceleration(0.15, 0.15, -200.0, Compliance(500.0, 200.0), GAINS)
    assert crash == -GAINS.yielding_m_s2


def samples(stiffness, damping, count=400, noise_n=0.0, exponent=1.0):
    rng = np.random.default_rng(0)
    depth = 0.0
    for i in range(count):
        speed = 0.1 + 0.05 * math.sin(0.05 * i)
        depth += speed * DT_S
        yield depth, speed, stiffness * depth**exponent + damping * speed + rng.normal(0.0, noise_n or 1e-12)


@pytest.mark.parametrize(("stiffness", "damping"), [(100.0, 0.0), (500.0, 100.0), (10_000.0, 200.0)])
def test_stiffness_estimate_finds_the_object(stiffness, damping):
    guess = QuickEstimator()
    for depth, speed, force in samples(stiffness, damping, noise_n=0.02):
        guess.update(depth, speed, force, DT_S)
    assert guess.compliance.stiffness_n_m == pytest.approx(stiffness, rel=0.1)
    assert guess.compliance.damping_n_s_m == pytest.approx(damping, abs=8.0)


def test_stiffness_estimate_sees_a_damper_within_five_milliseconds():
    guess = QuickEstimator()
    for depth, speed, force in samples(500.0, 200.0, count=5):
        guess.update(depth, speed, force, DT_S)
    assert guess.compliance.damping_n_s_m == pytest.approx(200.0, rel=0.1)


def test_stiffness_estimate_follows_a_stiffening_object():
    guess = QuickEstimator()
    # F = a depth^2: the slope at the end is twice the chord, a fit to everything three quarters of it.
    speed_m_s, hardening = 0.05, 2e5
    for i in range(140):
        depth = speed_m_s * i * DT_S
        guess.update(depth, speed_m_s, hardening * depth**2, DT_S)
    chord = hardening * depth
    assert 1.05 * chord < guess.compliance.stiffness_n_m < 2.0 * chord


def test_rest_does_not_update_the_force_check():
    guess = QuickEstimator()
    for row in samples(1000.0, 50.0):
        guess.update(*row, DT_S)
    before = guess.compliance
    for _ in range(5000):
        guess.update(0.01, 0.0, 25.0, DT_S)
    assert guess.compliance == before
    guess.reset()
    assert guess.compliance != before
