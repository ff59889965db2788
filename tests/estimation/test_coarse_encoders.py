"""Presses that span few steps of the encoders."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from palpate.estimation.data.tick_channels import contact_channels
from palpate.estimation.estimate import Identifiability
from tests.estimation import contact_data
from tests.estimation.little_probe import kelvin_voigt, probe, ticks

STEP_RAD = 2 * np.pi / 4096
LEVERS_M = np.array([0.25, 0.20, 0.10])
TURNS_RAD_M = np.array([1.0, 2.0, 3.5])  # of each joint by the tip's way; times the levers, they make 1
DAMPING = 60.0


@cache
def pressed(stiffness, seed):
    """A channel from joints that are read in steps of 1.5 mrad, and where the surface really was."""
    rng = np.random.default_rng(1000 + seed)
    surface_m = 0.43 + 0.01 * rng.random()
    truth = probe(
        kelvin_voigt(stiffness, DAMPING),
        surface_m=surface_m,
        speeds=(0.05, 0.02, 0.01),
        seed=seed,
        hold_s=0.1,
    )
    zeros = rng.random(3)
    read = np.round((np.outer(truth.true_along_m, TURNS_RAD_M) + zeros) / STEP_RAD) * STEP_RAD
    seen = replace(truth, along_m=(read - zeros) @ LEVERS_M)
    (channel,) = contact_channels(ticks(seen, joint_position_rad=read), tared=True)
    return channel, surface_m


estimated = partial(contact_data.estimated, surface_found=True)


@pytest.mark.parametrize("name", ["lsq", "robust", "rls"])
def test_press_of_few_encoder_steps_is_reported_as_undetermined(name):
    channel, _ = pressed(7100.0, 0)
    found = estimated(channel, by=name)
    assert found.identifiability is Identifiability.NONE
    assert "steps of the encoder" in found.note
    assert not np.isfinite(found["stiffness.k"].interval).any()


def test_surface_of_a_stiff_object_is_at_first_contact():
    for seed in range(3):
        channel, surface_m = pressed(7100.0, seed)
        surface = channel.surface
        assert surface.highest_m <= surface_m <= surface.deepest_m
        assert abs(surface.position_m - surface_m) < channel.position_step
        assert abs(surface.position_m - surface_m) < 2 * surface.std_err_m
        assert estimated(channel)["contact_offset.offset"].value == pytest.approx(0.0, abs=1e-8)


def test_intervals_include_the_encoder_step_uncertainty():
    inside, inside_without = 0, 0
    for seed in range(6):
        channel, _ = pressed(3000.0, seed)
        with_steps = estimated(channel)["stiffness.k"].interval
        without = estimated(replace(channel, position_step=0.0))["stiffness.k"].interval
        assert with_steps[0] < without[0] < without[1] < with_steps[1]
        inside += with_steps[0] <= 3000.0 <= with_steps[1]
        inside_without += without[0] <= 3000.0 <= without[1]
    assert inside == 6
    assert inside_without < 6


def test_damping_is_corrected_for_encoder_steps_within_its_interval():
    """Steps make the derived velocity noisy, and least squares take that for a smaller damping."""
    found = [estimated(pressed(3000.0, seed)[0])["damping.c"] for seed in range(6)]
    assert np.mean([each.value for each in found]) == pytest.approx(DAMPING, rel=0.12)
    assert all(each.interval[0] <= DAMPING <= each.interval[1] for each in found)


def test_fine_encoder_widens_no_interval():
    (channel,) = contact_channels(ticks(probe(kelvin_voigt(800.0, 40.0), seed=1)), tared=True)
    fine = estimated(replace(channel, position_step=1e-9))["stiffness.k"]
    none = estimated(replace(channel, position_step=0.0))["stiffness.k"]
    assert fine.std_err == pytest.approx(none.std_err, rel=1e-6)


def test_first_reading_in_contact_does_not_raise_the_surface():
    """It may be half a step too high; a sample that is known to press is not cut off at the surface."""
    for seed in range(3):
        channel, surface_m = pressed(1500.0, seed)
        offset = estimated(channel)["contact_offset.offset"]
        assert abs(channel.surface.position_m + offset.value - surface_m) < 0.4 * channel.position_step
