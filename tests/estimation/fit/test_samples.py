"""Fits to single samples: at the Cramer-Rao bound, and near it among outliers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.effect import Parameter
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import Identifiability
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.irls import Loss
from palpate.estimation.fit.samples import _has_converged, _inside, fit_samples
from palpate.estimation.model import Model
from tests.estimation.contact_data import base_model, channel, estimated, swing
from tests.estimation.fit.test_fit_problem import problem

TRUTH = {"hunt_crossley.k": 2000.0, "hunt_crossley.b": 1500.0, "hunt_crossley.n": 1.3}
NOISE_N = 0.02


def hunt_crossley_data(seed, outliers=0.0, noise=NOISE_N):
    rng = np.random.default_rng(seed)
    t, x, v = swing()
    k, b, n = TRUTH.values()
    force = k * x**n + b * x**n * v + noise * rng.standard_normal(len(t))
    wrong = rng.random(len(t)) < outliers
    return channel(np.where(wrong, force + rng.uniform(-1.0, 4.0, len(t)), force), x, v, t)


def relative_errors(found):
    return np.array([found.parameters[name] / true - 1 for name, true in TRUTH.items()])


def cramer_rao():
    """Relative bound from derivatives worked out by hand."""
    _, x, v = swing()
    k, b, n = TRUTH.values()
    jacobian = np.column_stack([x**n, x**n * v, (k + b * v) * x**n * np.log(x)])
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * NOISE_N / np.array([k, b, n])


@pytest.mark.parametrize("loss", list(Loss))
def test_gains_and_exponent_are_exact_without_noise(loss):
    found = fit_samples(base_model("hunt_crossley"), hunt_crossley_data(0, noise=0.0), loss=loss)
    np.testing.assert_allclose(relative_errors(found), 0.0, atol=1e-5)


@pytest.mark.parametrize(("loss", "outliers", "times"), [(Loss.LINEAR, 0.0, 1.3), (Loss.CAUCHY, 0.3, 2.5)])
def test_errors_are_near_the_cramer_rao_bound_and_within_narrow_intervals(loss, outliers, times):
    model, errors, held, stated = base_model("hunt_crossley"), [], [], []
    for seed in range(12):
        found = fit_samples(model, hunt_crossley_data(seed, outliers), loss=loss)
        errors.append(relative_errors(found))
        low, high = found.covariance.intervals(np.array(list(found.parameters.values()))).T
        held.append((low <= list(TRUTH.values())) & (list(TRUTH.values()) <= high))
        stated.append(np.sqrt(np.diag(found.covariance.matrix)) / list(TRUTH.values()))
    scatter = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(scatter < times * cramer_rao())
    assert np.all(np.mean(held, axis=0) > 0.8)
    assert np.all(np.median(stated, axis=0) < 1.6 * scatter)


@pytest.mark.parametrize(
    ("stiffness", "damping", "exponent", "settled"),
    [
        (0.9e-4, 0.0, 0.0, True),  # of a largest gain of 1000
        (1.1e-4, 0.0, 0.0, False),
        (0.0, -0.9e-4, 0.0, True),  # a small gain moves by a share of the largest
        (0.0, 1.1e-4, 0.0, False),
        (0.0, 0.0, 0.9e-7, True),  # an inner parameter by one of its range
        (0.0, 0.0, -1.1e-7, False),
    ],
)
def test_search_is_converged_when_nothing_moves_by_much(stiffness, damping, exponent, settled):
    inner = {"e.n": Parameter("n", "1", 1.0, 4.0, (1.0, 2.0))}
    model = SimpleNamespace(gains={"e.k": None, "e.c": None}, inner=inner)
    before = {"e.k": 1000.0, "e.c": 0.1, "e.n": 1.5}
    after = {"e.k": 1000.0 + stiffness, "e.c": 0.1 + damping, "e.n": 1.5 + exponent}
    assert _has_converged(before, SimpleNamespace(model=model, parameters=after)) is settled


def test_only_selected_rows_count_and_least_squares_is_not_robust():
    found = fit_samples(base_model("hunt_crossley"), hunt_crossley_data(0, outliers=0.3))
    assert abs(relative_errors(found)[0]) > 0.2
    data = hunt_crossley_data(1)
    rows = np.arange(len(data)) % 2 == 0
    spoilt = replace(data, effort=np.where(rows, data.effort, 100.0))
    found = fit_samples(base_model("hunt_crossley"), spoilt, rows)
    np.testing.assert_allclose(relative_errors(found), 0.0, atol=0.02)
    assert np.std(found.residuals) < 0.03


def test_search_that_ends_at_a_bound_is_reported():
    t, x, v = swing()
    data = channel(1e9 * x**5, x, v, t)  # an exponent beyond what the effect allows
    found = estimated(data, "hunt_crossley")
    assert found["hunt_crossley.n"].value == pytest.approx(4.0)
    assert np.isnan(found["hunt_crossley.n"].std_err)
    assert np.isfinite(found["hunt_crossley.k"].std_err)
    assert found.identifiability is Identifiability.WEAK
    assert "hunt_crossley.n: the search ended at a physical bound" in found.note


def test_partner_at_its_bound_does_not_reduce_gain_uncertainty():
    # the surface lies 1.5 m off, 1 m is the bound: only the slope determines k
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 1.0, 1e-3)
    x = 0.2 + 0.01 * np.sin(9.0 * t)
    data = channel(2.0 * (x + 1.5) + 0.02 * rng.standard_normal(len(t)), x, np.gradient(x, t), t)
    found = estimated(data, by="robust", surface_found=True)
    assert np.isnan(found["contact_offset.offset"].std_err)
    level_alone = 0.02 / np.sqrt(np.sum((x + 1.0) ** 2))  # what k would be known to if that were the surface
    slope_alone = 0.02 / np.sqrt(np.sum((x - x.mean()) ** 2))  # what it is known to
    assert level_alone < 0.1 * slope_alone
    assert found["stiffness.k"].std_err == pytest.approx(slope_alone, rel=0.5)


def test_limit_that_nothing_reaches_leaves_the_stiffness_certain():
    rng = np.random.default_rng(8)
    t, x, _ = swing()
    data = channel(2000.0 * x + NOISE_N * rng.standard_normal(len(t)), x, 0.0 * x, t)
    model = Model("m", (EFFECTS["stiffness"](), EFFECTS["saturation"]()))
    limit = model.inner["saturation.limit"].upper
    start = solve_gains(problem(data), model, {"saturation.limit": limit})
    found = fit_samples(model, data, searched={False: start})
    force, unknown = found.covariance.std_err
    assert force == pytest.approx(NOISE_N / np.sqrt(x @ x), rel=0.3)
    assert np.isnan(unknown)


def test_jacobian_matches_the_formula():
    found = fit_samples(base_model("hunt_crossley"), hunt_crossley_data(7))
    _, x, v = swing()
    k, b, n = found.parameters.values()
    jacobian = np.column_stack([x**n, x**n * v, (k + b * v) * x**n * np.log(x)])
    np.testing.assert_allclose(found.jacobian, jacobian, rtol=1e-6, atol=1e-9)


def test_two_searched_effects_at_once():
    rng = np.random.default_rng(8)
    t, x, v = swing(4000)
    k, b, n = TRUTH.values()
    force = k * x**n * (1 + b / k * v) + 0.01 * rng.standard_normal(len(t))
    model = Model("both", (EFFECTS["hunt_crossley"](), EFFECTS["contact_offset"]()))
    found = fit_samples(model, channel(force, x - 0.0003, v, t))
    assert found.parameters["contact_offset.offset"] == pytest.approx(-0.0003, abs=5e-5)
    assert found.parameters["hunt_crossley.n"] == pytest.approx(1.3, abs=0.02)


@pytest.mark.parametrize(("share", "begins"), [(0.0, 0.001), (0.0005, 0.001), (0.3, 0.3), (1.0, 0.999)])
def test_search_starts_a_thousandth_of_its_range_off_a_bound(share, begins):
    """At one it would be stuck."""
    model = Model("m", (EFFECTS["contact_offset"](),))
    (name, one), *_ = model.inner.items()
    wide = one.upper - one.lower
    assert _inside(model, {name: one.lower + share * wide})[name] == pytest.approx(one.lower + begins * wide)
