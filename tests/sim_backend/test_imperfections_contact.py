"""Hidden contact effects follow their physics at a guided or falling tip."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from palpate.sim_backend.contact_laws import CONTACT_LAWS
from palpate.sim_backend.contact_laws.standard import HuntCrossleyLaw, KelvinVoigtLaw
from tests.sim_backend.hidden_parts import SPRING, STEP_S, hidden, hidden_slider, press, steps

K = SPRING.stiffness_n_m
ROUNDING_N = 1e-6  # the engine keeps the tip's position in single precision
RAMP = np.linspace(0.0, 0.02, 400)
IN_AND_OUT = np.concatenate([RAMP, RAMP[::-1]])


def test_elastic_laws_follow_their_equations():
    extra = press([hidden("cubic_stiffness", cubic_n_m3=3e5)], RAMP) - K * RAMP
    assert extra[-1] == pytest.approx(3e5 * 0.02**3)
    assert np.polyfit(np.log(RAMP[50:]), np.log(extra[50:]), 1)[0] == pytest.approx(3.0)
    softened = press([hidden("cubic_stiffness", cubic_n_m3=-3e5)], RAMP)
    assert softened[-1] == pytest.approx(K * 0.02 - 3e5 * 0.02**3)
    force = press([hidden("layered_stiffness", stiffness_n_m=800.0, depth_m=0.01)], RAMP)
    slope = np.gradient(force, RAMP)
    assert np.allclose(slope[:190], 500.0, rtol=1e-3)
    assert np.allclose(slope[210:], 1300.0, rtol=1e-3)
    nothing = KelvinVoigtLaw(stiffness_n_m=0.0, damping_n_s_m=0.0)
    law = HuntCrossleyLaw(stiffness=7000.0, damping=4000.0, exponent=1.5)
    entry = hidden("hunt_crossley", stiffness=7000.0, damping=4000.0, exponent=1.5)
    assert np.allclose(press([entry], IN_AND_OUT, law=nothing), press([], IN_AND_OUT, law=law))


def test_relaxation_after_a_ramp_matches_the_closed_form():
    relaxing = hidden("stress_relaxation", stiffness_n_m=300.0, time_s=0.1)
    ramp_s, hold_s, speed = 0.05, 0.4, 0.2
    t = steps(ramp_s + hold_s)
    extra = press([relaxing], speed * np.minimum(t, ramp_s)) - K * speed * np.minimum(t, ramp_s)
    peak = 300.0 * speed * 0.1 * (1.0 - np.exp(-ramp_s / 0.1))
    assert extra[t <= ramp_s][-1] == pytest.approx(peak, rel=1e-4)
    held = t > ramp_s
    assert np.allclose(extra[held], peak * np.exp(-(t[held] - ramp_s) / 0.1), rtol=1e-4)


def test_two_branches_answer_a_vibration_with_their_complex_modulus():
    entry = hidden(
        "stress_relaxation", stiffness_n_m=300.0, time_s=0.02, second_stiffness_n_m=150.0, second_time_s=0.2
    )
    t, omega = steps(4.0), 2.0 * np.pi * 5.0
    depth = 0.01 + 0.002 * np.sin(omega * t)
    late = t > 3.0
    wave = np.exp(-1j * omega * t[late])
    answer = 2j * np.mean((press([entry], depth) - K * depth)[late] * wave)
    expected = sum(0.002 * k * 1j * omega * T / (1 + 1j * omega * T) for k, T in ((300, 0.02), (150, 0.2)))
    assert answer == pytest.approx(expected, rel=1e-3)


def test_second_touch_finds_the_branches_still_relaxing():
    entry = hidden("stress_relaxation", stiffness_n_m=1000.0, time_s=0.2)
    hold, away = np.full(2000, 0.01), np.full(80, -0.01)
    again = press([entry], np.concatenate([hold, away, hold]), rate_m_s=0.0)
    fresh, soon = again[0], again[2080]
    tau_s = 0.2 * (K + 1000.0) / K  # of a free surface
    assert soon == pytest.approx(
        fresh - 1000.0 * 0.01 * (1 - np.exp(-0.5 / 0.2)) * np.exp(-0.02 / tau_s), rel=1e-3
    )
    assert not again[2000:2080].any()


@pytest.mark.parametrize(
    ("law", "entries", "free_m"),
    [
        (
            KelvinVoigtLaw(stiffness_n_m=K, damping_n_s_m=100.0),
            [hidden("dry_friction", friction_n=0.5, slip_m=1e-3)],
            lambda t: 0.01 * np.exp(-t / 0.2),
        ),
        (
            HuntCrossleyLaw(stiffness=7000.0, damping=7e5, exponent=1.5),
            [hidden("tool_compliance", compliance_m_n=1e-4)],
            lambda t: 0.01 - 0.01 * t,
        ),
        (
            SPRING,
            [hidden("stress_relaxation", stiffness_n_m=1000.0, time_s=0.1)],
            lambda t: 0.01 * 2 / 3 * np.exp(-t / 0.3),
        ),
    ],
)
def test_free_surface_recovers_without_force(law, entries, free_m):
    """The tip leaves it at 10 mm, and presses again slowly from the undeformed surface on."""
    held, in_air, again = np.full(4000, 0.01), np.full(800, -0.01), np.linspace(0.0, 0.01, 2000)
    force = press(entries, np.concatenate([held, in_air, again]), law=law)
    touch = int(np.argmax(force[4800:] > 0.0))
    assert again[touch] == pytest.approx(free_m((touch + 801) * STEP_S), rel=0.01)


def test_quadratic_damping_opposes_the_squared_speed():
    entry = [hidden("quadratic_damping", damping_n_s2_m2=100.0)]
    force = [press(entry, [0.015], rate)[0] - K * 0.015 for rate in (0.1, 0.2, -0.2)]
    assert force == pytest.approx([1.0, 4.0, -4.0])
    assert press(entry, [-1e-3], 1.0)[0] == 0.0


def test_sticky_surface_pulls_until_its_neck_tears_within_its_bond():
    height = np.array([2e-3, 0.5e-3, -1e-3, -2e-3, 0.0, 0.25e-3, 0.75e-3, 1.1e-3, 0.5e-3, -1e-3])
    force = press([hidden("adhesion", pull_off_n=2.0, neck_m=1e-3)], -height, 0.0)
    assert force == pytest.approx([0, 0, 0.5 - 2, 1.0 - 2, -2, -1.5, -0.5, 0, 0, 0.5 - 2])
    damped = KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=100.0)
    torn_out = press([hidden("adhesion", pull_off_n=2.0)], [0.01, 0.005], -1.0, damped)
    assert torn_out == pytest.approx([-2.0, -2.0])


def test_dented_surface_is_softer_at_first_and_recovers_in_its_time():
    force = press([hidden("plastic_set", share=0.2)], np.concatenate([IN_AND_OUT, IN_AND_OUT]))
    loading, unloading, again = force[:400], force[400:800], force[800:1200]
    assert loading == pytest.approx(0.8 * K * RAMP, abs=ROUNDING_N)
    assert unloading == pytest.approx(np.maximum(K * (RAMP[::-1] - 0.004), 0.0), abs=ROUNDING_N)
    assert again == pytest.approx(unloading[::-1], abs=ROUNDING_N)
    pressed, away = np.full(10, 0.02), np.full(2000, -0.01)
    entry = hidden("plastic_set", share=0.2, recovery_s=0.5)
    force = press([entry], np.concatenate([pressed, away, [0.003]]), 0.0)
    dent = 0.004 * np.exp(-0.5 / 0.5)
    assert force[-1] == pytest.approx(K * (0.003 - dent), rel=1e-3)
    damped = KelvinVoigtLaw(stiffness_n_m=0.0, damping_n_s_m=100.0)
    force = press([hidden("plastic_set", share=0.25)], [0.01, 0.02, 0.015], [0.1, 0.1, -0.0001], damped)
    assert force == pytest.approx([7.5, 7.5, 0.0], abs=0.011)


def test_dry_friction_is_a_rate_independent_loop():
    entry = [hidden("dry_friction", friction_n=0.5, slip_m=1e-4)]
    depth = 0.01 + 0.005 * np.sin(np.linspace(0, 4 * np.pi, 2000))
    fast, slow = press(entry, depth), press(entry, np.repeat(depth, 5))
    assert np.allclose(fast, slow[::5])
    extra = fast - K * depth
    falling = np.gradient(depth) < 0
    middle = np.abs(depth - 0.01) < 0.003
    assert extra[middle & ~falling][500:] == pytest.approx(0.5, abs=1e-6)
    assert extra[middle & falling] == pytest.approx(-0.5, abs=1e-6)
    cycle = slice(1000, 2000)
    assert np.trapezoid(extra[cycle], depth[cycle]) == pytest.approx(4 * 0.5 * 0.005, rel=0.05)


def test_dry_friction_restarts_at_each_touch():
    force = press([hidden("dry_friction", friction_n=0.5, slip_m=1e-3)], [0.01, -0.01, 1e-3], 0.0)
    assert force[2] == pytest.approx(K * 1e-3 + 0.5 * (1 - np.exp(-1.0)))


def test_offset_moves_the_surface():
    entry = hidden("contact_offset", offset_m=0.004)
    assert press([entry], IN_AND_OUT - 0.01) == pytest.approx(press([], IN_AND_OUT - 0.006), abs=ROUNDING_N)


def test_tool_and_object_in_series_share_the_depth_and_the_force():
    force = press([hidden("tool_compliance", compliance_m_n=5e-4)], RAMP, 0.0)
    assert force == pytest.approx(RAMP / (5e-4 + 1 / K), abs=ROUNDING_N)
    law = HuntCrossleyLaw(stiffness=7000.0, damping=0.0, exponent=1.5)
    force = press([hidden("tool_compliance", compliance_m_n=3e-4)], [0.012], 0.0, law)[0]
    expected = brentq(lambda f: f - 7000.0 * (0.012 - 3e-4 * f) ** 1.5, 0.0, 9.0)
    assert force == pytest.approx(expected, abs=ROUNDING_N)


def test_tool_on_a_damped_object_follows_the_differential_equation():
    stiffness, damping, compliance = 500.0, 60.0, 2e-3
    t = steps(0.2)
    depth, rate = 0.01 * np.sin(10 * t), 0.1 * np.cos(10 * t)
    law = KelvinVoigtLaw(stiffness_n_m=stiffness, damping_n_s_m=damping)
    force = press([hidden("tool_compliance", compliance_m_n=compliance)], depth, rate, law)

    def object_rate(time_s, object_depth):
        return ((0.01 * np.sin(10 * time_s) - object_depth) / compliance - stiffness * object_depth) / damping

    solution = solve_ivp(object_rate, (0, 0.2), [0.0], t_eval=t, rtol=1e-9, atol=1e-12)
    assert force == pytest.approx((depth - solution.y[0]) / compliance, abs=0.01)
    assert force[0] < 0.1 < damping * 0.1  # no jump at touch, unlike the dashpot alone


@given(
    st.floats(1e-5, 0.05),
    st.floats(-1.0, 1.0),
    st.floats(1e-6, 1e-2),
    st.sampled_from(
        [
            KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=20.0),
            KelvinVoigtLaw(stiffness_n_m=1e4, damping_n_s_m=200.0, sticky=True),
            HuntCrossleyLaw(stiffness=7000.0, damping=4000.0, exponent=1.5),
            HuntCrossleyLaw(stiffness=1e6, damping=1e6, exponent=3.0),
        ]
    ),
)
@example(1e-5, 1.0, 0.0078125, KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=20.0))
def test_tool_and_object_carry_the_same_force_for_every_law(depth, rate, compliance, law):
    force = press([hidden("tool_compliance", compliance_m_n=compliance)], [depth], rate, law)[0]
    squeeze = compliance * force
    # Where a dashpot's force jumps, anything up to it is right; what is compared is known to 0.1 mN.
    at_the_surface = abs(depth - squeeze) < max(1e-8, 1e-4 * compliance)
    object_n = law.force_n(depth - squeeze, rate - squeeze / STEP_S)
    assert at_the_surface or object_n == pytest.approx(force, abs=1e-4, rel=1e-4)


def test_tool_feels_other_hidden_effects_of_the_object():
    entries = [
        hidden("stress_relaxation", stiffness_n_m=500.0, time_s=0.05),
        hidden("tool_compliance", compliance_m_n=1e-3),
    ]
    force = press(entries, np.full(8000, 0.01), 0.0)
    assert force[0] == pytest.approx(0.01 / (1e-3 + 1 / 1000), rel=0.01)
    assert force[-1] == pytest.approx(0.01 / (1e-3 + 1 / K), rel=1e-6)


CONTACT = {
    "adhesion": {"pull_off_n": 1.0},
    "contact_offset": {"offset_m": 0.002},
    "cubic_stiffness": {"cubic_n_m3": 1e6},
    "dry_friction": {"friction_n": 0.5},
    "hunt_crossley": {"damping": 5000.0},
    "layered_stiffness": {"stiffness_n_m": 1000.0, "depth_m": 0.005},
    "plastic_set": {"share": 0.3, "recovery_s": 0.2},
    "quadratic_damping": {"damping_n_s2_m2": 200.0},
    "stress_relaxation": {"stiffness_n_m": 500.0, "time_s": 0.1},
    "tool_compliance": {"compliance_m_n": 1e-3},
}


@pytest.mark.parametrize("name", sorted(CONTACT))
@settings(max_examples=5, deadline=None)
@given(
    st.lists(st.floats(-0.005, 0.02), min_size=2, max_size=5),
    st.sampled_from([{"stiffness_n_m": 500.0, "damping_n_s_m": d} for d in (0.0, 30.0)]),
)
def test_no_effect_returns_more_work_than_it_took(name, corners, law):
    corners = [-0.01, *corners, -0.01]
    depth = np.interp(np.linspace(0, len(corners) - 1, 400 * len(corners)), np.arange(len(corners)), corners)
    force = press([hidden(name, **CONTACT[name])], depth, law=CONTACT_LAWS["kelvin_voigt"](**law))
    work = np.trapezoid(force, depth)
    slack = 2.0 * STEP_S * np.abs(np.gradient(depth, STEP_S)).max() * np.abs(force).max()
    assert work >= -slack


@pytest.mark.parametrize("damping", [0.0, 20.0])
@pytest.mark.parametrize("name", sorted(CONTACT))
def test_dropped_mass_comes_to_rest_or_bounces_no_higher(name, damping):
    law = KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=damping)
    world = hidden_slider(hidden(name, **CONTACT[name]), height_m=0.02, law=law)
    heights = []
    for time_s in steps(1.0)[::4]:
        world.advance_to(time_s)
        heights.append(world.truth().tip_position_world_m[2])
    assert np.isfinite(heights).all()
    assert max(heights) <= 0.02 * 1.01
    assert min(heights) > -0.2
