"""Stiffness and damping under the paper's conditions, on the simulator of little_probe.py."""

from functools import cache

import numpy as np
import pytest

from palpate.estimation.data.tick_channels import contact_channels
from palpate.estimation.estimators import ESTIMATORS
from palpate.robot_io.errors import InputError
from tests.estimation.contact_data import channel, estimated
from tests.estimation.little_probe import hunt_crossley, kelvin_voigt, probe, ticks

CORNERS = [(200.0, 0.0), (200.0, 100.0), (2000.0, 0.0), (2000.0, 100.0), (500.0, 20.0)]


@cache
def recorded(law, **settings):
    (data,) = contact_channels(ticks(probe(law, **settings)), tared=True)
    return data


def probed(law, name, model="kelvin_voigt", **settings):
    return estimated(recorded(law, **settings), model, name, surface_found=True)


@pytest.mark.parametrize(("stiffness", "damping"), CORNERS)
def test_stiffness_within_1_and_damping_within_5_percent(stiffness, damping):
    found = probed(kelvin_voigt(stiffness, damping), "robust")
    assert found["stiffness.k"].value == pytest.approx(stiffness, rel=0.01)
    assert found["damping.c"].value == pytest.approx(damping, rel=0.05, abs=0.2)


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_no_estimator_is_worse_than_the_paper_s_best(name):
    found = probed(kelvin_voigt(500.0, 100.0), name)
    assert found["stiffness.k"].value == pytest.approx(500.0, rel=0.065)
    assert found["damping.c"].value == pytest.approx(100.0, rel=0.184)


def test_intervals_contain_the_truth_with_an_unknown_surface():
    held = []
    for seed in range(12):
        found = probed(kelvin_voigt(1000.0, 20.0), "robust", seed=seed, speeds=(0.15, 0.06))
        pairs = zip(found.parameters, (1000.0, 20.0), strict=False)
        held.append([p.interval[0] <= t <= p.interval[1] for p, t in pairs])
    assert np.all(np.mean(held, axis=0) > 0.75)


def test_hunt_crossley_is_identified_with_surface_uncertainty():
    found = probed(hunt_crossley(5000.0, 8000.0, 1.4), "robust", "hunt_crossley")
    assert found["hunt_crossley.n"].value == pytest.approx(1.4, abs=0.01)
    assert found["hunt_crossley.k"].value == pytest.approx(5000.0, rel=0.03)
    assert found["hunt_crossley.b"].value == pytest.approx(8000.0, rel=0.03)
    (data,) = contact_channels(ticks(probe(kelvin_voigt(500.0, 20.0))), tared=True)
    errors = [estimated(data, surface_found=found)["stiffness.k"].std_err for found in (False, True)]
    assert errors[1] > 1.3 * errors[0]


def test_impossible_stiffness_is_reported_and_a_rounding_damping_is_not():
    t = np.arange(500) * 1e-3
    x, v = 0.005 + 0.004 * np.sin(20 * t), 0.08 * np.cos(20 * t)
    pulling, rounded = (estimated(channel(force, x, v, t)) for force in (-200 * x, 200 * x - 1e-12 * v))
    assert "stiffness.k: outside the physical bounds" in pulling.note
    assert pulling.unphysical == ("stiffness.k",)
    assert rounded["damping.c"].interval[1] < 0
    assert rounded.unphysical == ()


@pytest.mark.parametrize(
    ("depth_m", "words"),
    [
        (0.01, "the effort is 0 N in all 100 samples"),
        (-0.01, r"0 samples in use cannot .* 2 parameters.*was the object touched"),
    ],
)
def test_channel_without_a_contact_is_refused(depth_m, words):
    data = channel(np.zeros(100), np.full(100, depth_m), np.zeros(100), np.arange(100) * 1e-3)
    with pytest.raises(InputError, match=words):
        estimated(data)


@pytest.mark.parametrize(("what", "size"), [("position", 1e-155), ("position", 1e-310), ("effort", 1e-200)])
def test_numbers_too_small_to_be_squared_are_refused(what, size):
    t = np.arange(500) * 1e-3
    x, v = 0.005 + 0.004 * np.sin(20 * t), 0.08 * np.cos(20 * t)
    moved, force = (size, 1.0) if what == "position" else (1.0, size)
    data = channel(force * (200 * x + v), moved * x, moved * v, t)
    with pytest.raises(InputError, match=f"its {what} never exceeds .*is the unit right"):
        estimated(data)
