import numpy as np
import pytest

from estimation.effects import EFFECTS
from estimation.estimate import Identifiability
from estimation.estimate_channel import estimate_channel
from estimation.estimators import ESTIMATORS
from estimation.fitting.fit import fit
from estimation.fitting.loss import Loss
from estimation.model import Model
from tests.estimation.contact_data import base_model, channel, swing

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
def test_finds_gains_and_exponent_without_noise(loss):
    found = fit(base_model("hunt_crossley"), hunt_crossley_data(0, noise=0.0), loss=loss)
    np.testing.assert_allclose(relative_errors(found), 0.0, atol=1e-5)


def test_least_squares_reaches_the_cramer_rao_bound():
    model = base_model("hunt_crossley")
    errors = [relative_errors(fit(model, hunt_crossley_data(seed))) for seed in range(40)]
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 1.3 * cramer_rao())


def test_robust_loss_stands_30_percent_outliers_and_least_squares_does_not():
    model = base_model("hunt_crossley")
    data = [hunt_crossley_data(seed, outliers=0.3) for seed in range(15)]
    robust = [relative_errors(fit(model, each, loss=Loss.CAUCHY)) for each in data]
    rms = np.sqrt(np.mean(np.square(robust), axis=0))
    assert np.all(rms < [0.005, 0.017, 0.0015])
    assert np.all(rms < 2.5 * cramer_rao())
    assert abs(relative_errors(fit(model, data[0]))[0]) > 0.2


@pytest.mark.parametrize(("loss", "outliers"), [(Loss.LINEAR, 0.0), (Loss.CAUCHY, 0.2)])
def test_intervals_hold_the_truth(loss, outliers):
    model, held = base_model("hunt_crossley"), []
    for seed in range(40):
        found = fit(model, hunt_crossley_data(seed, outliers), loss=loss).estimate
        held.append([found[n].interval[0] <= true <= found[n].interval[1] for n, true in TRUTH.items()])
    assert np.all(np.mean(held, axis=0) > 0.85)


def test_only_the_chosen_rows_count():
    data = hunt_crossley_data(1)
    rows = np.arange(len(data)) % 2 == 0
    spoilt = data.effort.copy()
    spoilt[~rows] += 100.0
    found = fit(
        base_model("hunt_crossley"), channel(spoilt, data.position, data.velocity, data.time_s), rows=rows
    )
    np.testing.assert_allclose(relative_errors(found), 0.0, atol=0.02)
    assert found.residuals.shape == rows.shape
    assert found.rmse < 0.03
    assert len(found.estimate.residuals) == rows.sum()


def test_weights_follow_sigma():
    rng = np.random.default_rng(2)
    t, x, v = swing()
    sigma = np.where(np.arange(len(t)) < 1000, 0.01, 1.0)
    data = channel(500 * x + 20 * v + sigma * rng.standard_normal(len(t)), x, v, t)
    blind, told = (fit(base_model("kelvin_voigt"), data, sigma=s).estimate for s in (None, sigma))
    assert told["stiffness.k"].std_err < 0.2 * blind["stiffness.k"].std_err
    assert abs(told["stiffness.k"].value - 500) < 4 * told["stiffness.k"].std_err


def test_finds_where_the_surface_is():
    rng = np.random.default_rng(3)
    t, x, v = swing()
    data = channel(800 * x + 30 * v + 0.02 * rng.standard_normal(len(t)), x + 0.0004, v, t)
    found = fit(base_model("kelvin_voigt", surface_found=True), data).estimate
    offset = found["contact_offset.offset"]
    assert offset.unit == "m"
    assert abs(offset.value - 0.0004) < 4 * offset.std_err < 5e-5
    assert found["stiffness.k"].value == pytest.approx(800, rel=0.005)


def test_a_wrong_surface_would_bias_stiffness_and_damping():
    t, x, v = swing()
    data = channel(800 * x + 30 * v, x + 0.0004, v, t)
    found = fit(base_model("kelvin_voigt"), data).parameters
    assert abs(found["stiffness.k"] - 800) > 10


def test_a_nonlinear_sensor_is_fitted_with_all_else():
    rng = np.random.default_rng(4)
    t, x, v = swing()
    force = np.clip(800 * x + 10 * v, None, 7.0) + 0.01 * rng.standard_normal(len(t))
    model = base_model("kelvin_voigt").with_effect(EFFECTS["saturation"]())
    assert not model.is_linear_in_gains
    found = fit(model, channel(force, x, v, t))
    assert found.parameters["stiffness.k"] == pytest.approx(800, rel=0.005)
    assert found.parameters["damping.c"] == pytest.approx(10, rel=0.02)
    assert found.parameters["saturation.limit"] == pytest.approx(7.0, rel=0.002)


def test_says_when_the_search_ends_at_a_bound():
    t, x, v = swing()
    data = channel(1e9 * x**5, x, v, t)  # an exponent beyond what the effect allows
    found = fit(base_model("hunt_crossley"), data).estimate
    assert found["hunt_crossley.n"].value == pytest.approx(4.0)
    assert np.isnan(found["hunt_crossley.n"].std_err)
    assert np.isfinite(found["hunt_crossley.k"].std_err)
    assert found.identifiability is Identifiability.WEAK
    assert "hunt_crossley.n: the search ended at the bound" in found.note


def test_a_gain_is_no_surer_for_a_partner_that_ended_at_its_bound():
    # the surface lies 30 mm off, 20 mm is the bound: only the slope says what k is
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 1.0, 1e-3)
    x = 0.004 + 0.0002 * np.sin(9.0 * t)
    data = channel(100.0 * (x + 0.03) + 0.02 * rng.standard_normal(len(t)), x, np.gradient(x, t), t)
    model = base_model("kelvin_voigt", surface_found=True)
    found = estimate_channel(data, model, ESTIMATORS["robust"](), rng=np.random.default_rng(1))
    assert np.isnan(found["contact_offset.offset"].std_err)
    level_alone = 0.02 / np.sqrt(np.sum((x + 0.02) ** 2))  # what k would be known to if that were the surface
    slope_alone = 0.02 / np.sqrt(np.sum((x - x.mean()) ** 2))  # what it is known to
    assert level_alone < 0.1 * slope_alone
    assert found["stiffness.k"].std_err == pytest.approx(slope_alone, rel=0.5)


def test_starting_near_the_answer_gives_the_same_answer():
    data, model = hunt_crossley_data(5), base_model("hunt_crossley")
    far, near = fit(model, data), fit(model, data, start={"hunt_crossley.n": 1.35})
    assert near.parameters == pytest.approx(far.parameters, rel=1e-4)


def test_residuals_are_effort_minus_the_model_s_prediction():
    data = hunt_crossley_data(6)
    found = fit(base_model("hunt_crossley"), data)
    np.testing.assert_allclose(found.residuals, data.effort - found.predict(data), atol=1e-12)


def test_jacobian_agrees_with_difference_quotients_of_the_prediction():
    data = hunt_crossley_data(7)
    found = fit(base_model("hunt_crossley"), data)
    for column, (name, value) in enumerate(found.parameters.items()):
        step = 1e-5 * value
        up, down = ({**found.parameters, name: value + sign * step} for sign in (1, -1))
        slope = (found.model.predict(data, up) - found.model.predict(data, down)) / (2 * step)
        np.testing.assert_allclose(
            found.jacobian[:, column], slope, rtol=1e-3, atol=1e-6 * np.abs(slope).max()
        )


def test_two_searched_effects_at_once():
    rng = np.random.default_rng(8)
    t, x, v = swing(4000)
    k, b, n = TRUTH.values()
    force = k * x**n * (1 + b / k * v) + 0.01 * rng.standard_normal(len(t))
    model = Model("both", (EFFECTS["hunt_crossley"](), EFFECTS["contact_offset"]()))
    found = fit(model, channel(force, x - 0.0003, v, t))
    assert found.parameters["contact_offset.offset"] == pytest.approx(-0.0003, abs=5e-5)
    assert found.parameters["hunt_crossley.n"] == pytest.approx(1.3, abs=0.02)
