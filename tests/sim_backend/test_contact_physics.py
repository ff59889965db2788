"""A mass on an object follows the closed-form solution without gaining energy."""

import numpy as np
import pytest
from scipy.linalg import expm

from palpate.sim_backend.contact_laws.standard import HuntCrossleyLaw, KelvinVoigtLaw
from tests.sim_backend.parts import GRAVITY_M_S2, column, make_world, scenario, slider, watch

MASS_KG = 0.8


def analytic(stiffness, damping, start, times_s):
    """Depth and rate of a mass on a spring and a dashpot under gravity, from `start` = (depth, rate)."""
    rest_m = MASS_KG * GRAVITY_M_S2 / stiffness
    matrix = np.array([[0.0, 1.0], [-stiffness / MASS_KG, -damping / MASS_KG]])
    away = np.array([start[0] - rest_m, start[1]])
    return np.add([expm(matrix * time_s) @ away for time_s in times_s], [rest_m, 0.0])


def simulated(law, start, duration_s, rate_hz=4000.0):
    world = make_world(slider(-start[0], MASS_KG), scenario(law, rate_hz=rate_hz))
    world.place([-start[0]], [-start[1]])
    truths = watch(world, duration_s)
    world.close()
    return truths


def worst_error(stiffness, damping, rate_hz):
    """Largest distance from the closed form, relative to the amplitude of the motion."""
    law = KelvinVoigtLaw(stiffness_n_m=stiffness, damping_n_s_m=damping, sticky=True)
    rest_m = MASS_KG * GRAVITY_M_S2 / stiffness
    # The engine's velocity belongs half a step before its position; at rest at first, this is what it was.
    half_a_step_before = -0.5 / rate_hz * -GRAVITY_M_S2
    truths = simulated(law, (2 * rest_m, half_a_step_before), 0.3, rate_hz)
    expected = analytic(stiffness, damping, (2 * rest_m, 0.0), column(truths, "time_s"))
    return np.abs(column(truths, "depth_m") - expected[:, 0]).max() / rest_m


@pytest.mark.parametrize("stiffness", [100.0, 500.0, 10_000.0])
@pytest.mark.parametrize("damping", [0.0, 20.0, 200.0])
def test_mass_on_a_kelvin_voigt_object_follows_the_closed_form(stiffness, damping):
    assert worst_error(stiffness, damping, 4000.0) < 3e-3


@pytest.mark.parametrize("damping", [0.0, 20.0, 200.0])
def test_contact_is_second_order_accurate_in_the_step(damping):
    coarse, fine = worst_error(10_000.0, damping, 4000.0), worst_error(10_000.0, damping, 16_000.0)
    assert fine < coarse / 12


@pytest.mark.parametrize("stiffness", [100.0, 10_000.0])
def test_undamped_object_conserves_energy(stiffness):
    law = KelvinVoigtLaw(stiffness_n_m=stiffness, damping_n_s_m=0.0, sticky=True)
    depth = column(simulated(law, (2 * MASS_KG * GRAVITY_M_S2 / stiffness, 0.0), 3.0), "depth_m")
    early, late = np.ptp(depth[:1000]), np.ptp(depth[-1000:])
    assert late == pytest.approx(early, rel=2e-3)


def test_force_depth_and_rate_belong_to_one_instant():
    stiffness, damping = 2000.0, 100.0
    law = KelvinVoigtLaw(stiffness_n_m=stiffness, damping_n_s_m=damping)
    truths = watch(make_world(slider(-0.02, MASS_KG), scenario(law)), 0.1, period_s=0.25e-3)
    depth, force = column(truths, "depth_m"), column(truths, "force_n")
    central_rate = (depth[2:] - depth[:-2]) / 0.5e-3
    unexplained = force[1:-1] - stiffness * depth[1:-1] - damping * central_rate
    loaded = force[1:-1] > 0
    # With the engine's own velocity, half a step old, this would be up to 0.4 N.
    assert np.abs(unexplained[loaded][2:]).max() < 0.05


def test_dry_object_never_pulls_and_a_sticky_one_does():
    parameters = {"stiffness_n_m": 300.0, "damping_n_s_m": 60.0}
    lowest = {}
    for sticky in (False, True):
        world = make_world(slider(-0.005), scenario(KelvinVoigtLaw(**parameters, sticky=sticky)))
        world.place([-0.005], [0.5])  # torn out at 0.5 m/s
        lowest[sticky] = column(watch(world, 0.02, 0.25e-3), "force_n").min()
        world.close()
    assert lowest[False] == 0.0
    assert lowest[True] < -10.0


def test_object_is_rendered_only_below_its_surface():
    truths = watch(make_world(slider(0.05), scenario()), 0.2)
    depth, force = column(truths, "depth_m"), column(truths, "force_n")
    assert not force[depth <= 0].any()
    assert force[depth > 0].max() > 1.0
    fall_m = 0.5 * GRAVITY_M_S2 * column(truths, "time_s") ** 2
    assert np.allclose(depth[depth <= 0], fall_m[depth <= 0] - 0.05, atol=2e-4)


def test_hunt_crossley_object_takes_a_touch_without_a_jump():
    law = HuntCrossleyLaw(stiffness=7000.0, damping=4000.0, exponent=1.5)
    force = column(simulated(law, (-1e-4, 0.15), 0.01), "force_n")
    assert np.diff(force).max() < 1.0
    assert force.max() > 0.5


@pytest.mark.parametrize("stiffness", [100.0, 7100.0, 10_000.0])
@pytest.mark.parametrize("damping", [0.0, 200.0])
def test_drop_onto_the_object_returns_no_extra_energy(stiffness, damping):
    law = KelvinVoigtLaw(stiffness_n_m=stiffness, damping_n_s_m=damping)
    height = -column(watch(make_world(slider(0.02, MASS_KG), scenario(law)), 2.0), "depth_m")
    assert height[np.argmax(height < 0) :].max() <= 0.02 * (1.01 if damping == 0 else 0.9)
