"""Linear fit and inner search against numpy and scipy, and intervals against the scatter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from palpate.estimation.base_model import ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind, Information
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.blocks import block_average, with_load
from palpate.estimation.fit.fit_problem import linearize_inner, solve_gains
from palpate.estimation.fit.fit_result import final_solution, fit_model, fit_problem
from palpate.estimation.fit.intervals import _largest_error, estimate_parameters, inner_slopes
from palpate.estimation.fit.normal_equations import (
    WHITE,
    estimate_ar_noise,
    gram_matrices,
    held_out_sse,
    solve_normal_equations,
)
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.signals.cache_by_array import FitCache, IdentityKey
from tests.estimation.fits import MODEL, fits
from tests.estimation.presses import K, channel, kelvin_voigt, session
from tests.estimation.swings import DAMPING, INERTIA, NOISE_NM, WEIGHT, read, swings

PRESS, SWING = (MODELS[name]().build(ModelContext()) for name in ("kelvin_voigt", "pendulum"))


def _moments(columns, target, fold, folds):
    both = np.column_stack([columns, target])
    return gram_matrices(both[fold == f] for f in range(folds))


def with_effects(base, *names):
    return Model(base.name, (*base.effects, *(EFFECTS[name]() for name in names)))


POWER_LAW = Model("m", (EFFECTS["power_law_stiffness"](), EFFECTS["damping"]()))


def linear_problem():
    rng = np.random.default_rng(0)
    columns, fold = rng.normal(size=(300, 3)) * [1.0, 50.0, 1e-3], rng.integers(0, 4, 300)
    return columns, columns @ [2.0, -0.1, 500.0] + rng.normal(size=300), fold


def test_prior_information_counts_as_training_samples():
    columns, target, fold = linear_problem()
    mine, others = fold < 3, fold == 3
    gram, told = columns[others].T @ columns[others], columns[others].T @ target[others]
    known = Information(np.tile(gram, (4, 1, 1)), np.tile(told, (4, 1)))
    equations = replace(_moments(columns[mine], target[mine], fold[mine], 3), prior=known)
    found = solve_normal_equations(equations)
    assert found.gains == pytest.approx(np.linalg.lstsq(columns, target, rcond=None)[0], rel=1e-6)
    for number in range(3):
        train, out = fold != number, fold == number
        own = np.linalg.lstsq(columns[train], target[train], rcond=None)[0]
        assert found.fold_gains[number] == pytest.approx(own, rel=1e-6)
        left = target[out] - columns[out] @ own
        assert found.held_out[number] == pytest.approx(left @ left, rel=1e-6)
    part = solve_normal_equations(equations.only(np.array([True, False, True])))
    assert part.gains == pytest.approx(np.linalg.lstsq(columns[:, [0, 2]], target, rcond=None)[0], rel=1e-6)
    assert np.isnan(found.standard_errors).all()  # nobody said how many samples there are


def test_held_out_errors_are_those_of_ridge_regression_without_the_fold():
    columns, target, fold = linear_problem()
    found = held_out_sse(_moments(columns, target, fold, 4), np.array([[1e-9] * 3, [0.1] * 3]))
    unit = columns / np.linalg.norm(columns, axis=0)
    for row, ridge in zip(found, (1e-9, 0.1), strict=True):
        for number in range(4):
            train = fold != number
            system = unit[train].T @ unit[train] + ridge * np.eye(3)
            left = target - unit @ np.linalg.solve(system, unit[train].T @ target[train])
            assert row[number] == pytest.approx(left[~train] @ left[~train], rel=1e-6)


def test_equal_columns_do_not_break_the_fit():
    column = np.random.default_rng(1).normal(size=(200, 1))
    found = solve_normal_equations(
        _moments(np.hstack([column, column]), 3 * column[:, 0], np.arange(200) % 3, 3)
    )
    assert found.gains.sum() == pytest.approx(3.0, rel=1e-6)
    assert found.held_out.sum() < 1e-6


@pytest.mark.parametrize("memory", [(0.9,), (0.5, 0.3), ()])
def test_ar_noise_is_identified_and_whitened(memory):
    rng, run, every = np.random.default_rng(2), np.repeat(np.arange(10), 1000), np.ones(10000, dtype=bool)
    made = [lfilter([1.0], [1.0, *(-m for m in memory)], rng.normal(size=1200))[200:] for _ in range(10)]
    noise = np.concatenate(made)
    noise_model = estimate_ar_noise(noise, run, every)
    assert noise_model.coefficients == pytest.approx([*memory, *[0.0] * (4 - len(memory))], abs=0.05)
    kept = noise_model.used(run, every)
    assert not kept[[0, 1, 2, 3, 1000, 5003]].any()
    white = noise_model.whiten(noise)[kept]
    assert np.std(white) == pytest.approx(1.0, rel=0.03)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03


def test_ar_noise_is_not_correlated_across_runs():
    noise = np.random.default_rng(5).normal(size=(2000, 6))
    noise[1:, 0] = noise[:-1, -1]  # white within each run
    run = np.repeat(np.arange(2000), 6)
    noise_model = estimate_ar_noise(noise.ravel(), run, np.ones(len(run), dtype=bool))
    assert noise_model.coefficients == pytest.approx([0.0] * 4, abs=0.04)
    assert estimate_ar_noise(0.0 * noise.ravel(), run, run >= 0) is WHITE


def test_coarse_problem_has_the_folds_and_nearly_the_gains_of_the_samples():
    fit = fit_model(swings(3, rate_hz=1000.0), SWING, {})
    blocked, coarse = fit.problem.blocked, fit.coarse_problem.blocked
    assert coarse.rows.shape == (len(blocked), 1)
    for name in ("effort", "fold", "run", "trusted"):
        np.testing.assert_array_equal(getattr(coarse, name), getattr(blocked, name))
    gains = solve_gains(fit.coarse_problem, SWING, {}).parameters
    assert gains == pytest.approx(fit.solution.parameters, rel=0.01)
    residual = fit.residual_on_blocks
    np.testing.assert_array_equal(residual[blocked.trusted], fit.solution.residual[blocked.trusted])
    assert 0 < np.sum(~blocked.trusted) == np.sum(residual == 0.0)


def test_blocks_stay_within_interleaved_runs():
    data = session(3)
    blocked = block_average(replace(data, run=np.arange(len(data)) % 3))
    assert (blocked.rows % 3 == blocked.run[:, None]).all()
    assert (np.diff(blocked.rows, axis=1) == 3).all()


def power_law(t, x, v, run):
    return np.where(x > 0, 2.0e4 * np.maximum(x, 0.0) ** 1.7 + 15.0 * v, 0.0).clip(0.0)


@pytest.mark.parametrize(
    ("model", "made", "start"),
    [
        (POWER_LAW, lambda: session(7, power_law), {"power_law_stiffness.n": 1.5}),
        (
            with_effects(PRESS, "contact_offset"),
            lambda: session(8, lambda t, x, v, run: kelvin_voigt(x - 6e-4, v)),
            {},
        ),
        (
            with_effects(SWING, "coulomb_friction"),
            lambda: swings(6, lambda q, v, a: 0.4 * np.tanh(v / 0.05)),
            {"coulomb_friction.transition": 0.2},
        ),
    ],
)
def test_inner_parameters_match_scipy_over_all_parameters(model, made, start):
    """Of the same blocks; scipy moves gains and inner parameters together."""
    found = fit_model(made(), model, start)
    problem, solution = found.problem, found.solution
    names = [*model.gains, *model.inner]
    scale = np.array([abs(solution.parameters[n]) or 1e-6 for n in names])

    def residual(numbers):
        predicted = model.predict(problem.blocked.data, dict(zip(names, numbers * scale, strict=True)))
        return (problem.blocked.effort - problem.blocked.reduce(predicted))[problem.used]

    ours = np.array([solution.parameters[n] for n in names]) / scale
    best = least_squares(residual, ours * 1.002, x_scale="jac", xtol=1e-12, ftol=1e-12)
    assert np.sum(residual(ours) ** 2) <= 1.001 * 2.0 * best.cost


def slowly_swung(seed):
    return swings(seed, runs=3, rate_hz=100.0)


@pytest.mark.parametrize(
    ("parameter", "truth", "made", "model"),
    [
        ("viscous_friction.d", DAMPING, slowly_swung, SWING),
        # The acceleration is derived.
        ("pendulum.inertia", INERTIA, lambda seed: read(slowly_swung(seed), noise=2e-5, seed=seed), SWING),
        ("stiffness.k", K, lambda seed: session(seed, correlation=0.9), PRESS),
    ],
)
def test_95_percent_intervals_hold_the_truth(parameter, truth, made, model):
    """Of 12 data sets in 9 or more: fewer come by chance in 0.2 %; nor are they much too wide."""
    fits = (final_solution(fit_model(made(seed), model, {})) for seed in range(12))
    found = [estimate_parameters(*fit)[parameter] for fit in fits]
    off = np.array([(one.value - truth) / one.std_err for one in found])
    assert np.sum(np.abs(off) < 1.96) >= 9
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.4


def test_mass_uncertainty_includes_its_smoothed_acceleration():
    """Smoothing cuts peaks, so that the mass seems larger in every run; the residual does not show it."""
    exact, kernel = swings(3, rate_hz=500.0), np.ones(31) / 31.0
    cut = np.concatenate(
        [np.convolve(exact.acceleration[exact.run == r], kernel, "same") for r in exact.runs]
    )
    smoothed = replace(exact, acceleration=cut)
    one, two = (
        estimate_parameters(*final_solution(fit_model(data, SWING, {})))["pendulum.inertia"]
        for data in (exact, smoothed)
    )
    assert abs(one.value - INERTIA) < 3.0 * one.std_err
    assert two.value - INERTIA > 3.0 * one.std_err
    assert abs(two.value - INERTIA) < 3.0 * two.std_err


def test_sample_carried_over_the_surface_has_no_slope():
    model, name = with_effects(PRESS, "contact_offset"), "contact_offset.offset"
    problem, solution = final_solution(fit_model(session(4), model, {}))
    rows = problem.blocked.rows[problem.used].ravel()
    x, v = problem.blocked.data.position[rows], problem.blocked.data.velocity[rows]
    touching = float(x[(x > 1e-4) & (v > 0.02)].min()) + 1e-9
    there = solve_gains(problem, model, {**solution.parameters, name: touching})
    (slope,) = inner_slopes(problem, there)
    assert 0.9 * K < np.abs(slope).max() < 3.0 * K


ROTOR, SHARE = 0.03, 0.3


def geared():
    """A pendulum on a drive whose gear rubs with a share of what passes it; the rotor does not."""

    def torque(q, v, a):
        return ROTOR * a + SHARE * np.abs(INERTIA * a + WEIGHT * np.sin(q)) * np.tanh(v / 0.02)

    return swings(11, torque)


def test_gear_load_is_the_transmitted_torque():
    base = ("pendulum", "viscous_friction")
    data = with_load(
        geared(), SWING, {"pendulum.inertia": 0.08, "pendulum.gravity": 2.0, "viscous_friction.d": 0}
    )
    assert data.context["load"] == pytest.approx(0.08 * data.acceleration + 2.0 * np.sin(data.position))
    rubbing = EFFECTS["load_dependent_friction"]().suited_to(data)
    model = Model("m", (*(EFFECTS[name]() for name in base), rubbing))
    start = {"load_dependent_friction.transition": 0.02, "load_dependent_friction.link_share": 0.4}
    found = fit_model(geared(), model, start).solution.parameters
    assert found["load_dependent_friction.link_share"] == pytest.approx(INERTIA / (INERTIA + ROTOR), abs=0.03)
    assert found["load_dependent_friction.mu"] == pytest.approx(SHARE, abs=0.015)
    assert found["pendulum.inertia"] == pytest.approx(INERTIA + ROTOR, rel=0.02)


def test_contact_and_given_loads_are_kept():
    contact = session(1)
    assert with_load(contact, PRESS, {}) is contact
    brought = replace(swings(1), context={"load": np.ones(len(swings(1)))})
    assert with_load(brought, SWING, {}) is brought


def test_models_that_share_work_are_fitted_as_alone():
    """Also where the load, which one effect takes from the model around it, changes from model to model."""
    data, shared = geared(), FitCache()
    rubbing = with_effects(SWING, "load_dependent_friction", "coulomb_friction")
    start = {"load_dependent_friction.transition": 0.01, "coulomb_friction.transition": 0.02}
    for model in (rubbing, rubbing.without("coulomb_friction"), rubbing.without("viscous_friction")):
        together, alone = (fit_model(data, model, start, cache=cache) for cache in (shared, None))
        assert together.solution.parameters == pytest.approx(alone.solution.parameters, rel=1e-9)
        assert together.flexible.by_signal == pytest.approx(alone.flexible.by_signal, rel=1e-9, abs=1e-12)
    assert shared.total_bytes > 0


def test_noise_floor_of_all_runs_is_the_floor_and_of_some_their_own():
    """A friction is missing, and the last run is as noisy as three."""
    data = swings(1, lambda q, v, a: 0.3 * np.tanh(v / 0.01))
    last = data.run == data.runs[-1]
    noise = np.random.default_rng(1).normal(0.0, 3.0 * NOISE_NM, len(data))
    base = Model("pendulum", (EFFECTS["pendulum"](), EFFECTS["viscous_friction"]()))
    found = fit_model(replace(data, effort=data.effort + noise * last), base, {})
    assert found._floor_in_runs(data.runs) == pytest.approx(found.floor(), rel=0.01)
    quiet, loud = found._floor_in_runs(data.runs[:-1]), found._floor_in_runs(data.runs[-1:])
    assert quiet == pytest.approx(NOISE_NM, rel=0.7)
    assert loud == pytest.approx(np.sqrt(10.0) * NOISE_NM, rel=0.2)


def test_cache_evicts_the_least_recently_used(monkeypatch):
    monkeypatch.setattr("palpate.estimation.signals.cache_by_array.MAX_BYTES", 3 * 80)
    cache, asked = FitCache(), []

    def made(number):
        asked.append(number)
        return np.full(10, float(number))

    for number in (0, 1, 2, 0, 3, 0, 1):
        assert cache.get_or_compute(number, lambda n=number: made(n))[0] == number
    assert asked == [0, 1, 2, 3, 1]  # 1 had to go for 3, 0 had just been asked for again
    assert cache.total_bytes == 3 * 80
    assert not cache.get_or_compute(1, lambda: made(1)).flags.writeable  # callers share the array


def test_cache_counts_an_array_that_its_keys_keep_alive_once(monkeypatch):
    monkeypatch.setattr("palpate.estimation.signals.cache_by_array.MAX_BYTES", 4 * 80)
    cache, load = FitCache(), np.zeros(20)
    for number in range(2):
        cache.get_or_compute((IdentityKey(load), number), lambda: np.ones(10), load)
    assert cache.total_bytes == 4 * 80
    cache.get_or_compute("a", lambda: np.ones(10))
    assert cache.total_bytes == 4 * 80  # one of the two results is discarded, and the other keeps the load
    cache.get_or_compute("b", lambda: np.ones(10))
    assert cache.total_bytes == 2 * 80


@pytest.mark.parametrize(
    ("name", "inner"), [("dry_friction", {"presliding": 1e-4, "transition": 1e-4}), ("lag", {"tau": 0.01})]
)
def test_linearized_parts_match_the_whole_model(name, inner):
    data, effect = session(1), EFFECTS[name]()
    base = Model("m", tuple(EFFECTS[one]() for one in ("stiffness", "contact_offset", "stress_relaxation")))
    model, there = base.with_effect(effect), {"contact_offset.offset": 1e-3, "stress_relaxation.tau": 0.3}
    own = {f"{name}.{key}": value for key, value in inner.items()}
    start = {**there, **dict.fromkeys(own, 1.0)}
    found = linearize_inner(block_average(data), model, effect, start)(inner)
    for one, other in zip(found, model.parts(data, {**there, **own}), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.parametrize(
    "names", [("contact_offset", "cubic_stiffness"), ("cubic_stiffness", "contact_offset")]
)
@pytest.mark.parametrize(
    ("offset_m", "k", "k3"), [(0.004, 300.0, 3e6), (0.005, 800.0, 2e7), (-0.003, 300.0, 3e5)]
)
def test_surface_is_identified_with_a_stiffening_spring(names, offset_m, k, k3):
    """Another minimum has a surface that is hardly off and a stiffness below zero."""

    def law(t, x, v, run):
        depth = np.maximum(x - offset_m, 0.0)
        return k * depth + k3 * depth**3

    found = fits(session(3, law, runs=4), MODEL, names)[-1]
    assert found.values["contact_offset.offset"] == pytest.approx(offset_m, abs=1e-4)
    assert found.values["stiffness.k"] == pytest.approx(k, rel=0.1)
    assert found.unphysical == ()


@pytest.mark.parametrize(("value", "widest"), [(5e3, 2e5), (5e4, 5e5), (8e6, 8e7)])
def test_parameters_are_undetermined_for_an_implausibly_large_error(value, widest):
    (k,) = EFFECTS["stiffness"].gains
    assert _largest_error(k, value) == widest


@pytest.mark.parametrize("start_s", [0.02, 0.0475, 0.06])
def test_damping_is_distinguished_from_a_delay_of_equal_phase(start_s):
    """A delay that is shorter by c/k, without a damping, is a saddle of the error."""
    rng, stiffness, damping, delay_s = np.random.default_rng(0), 1100.0, 19.5, 0.065
    t = np.arange(0.0, 12.0, 0.004)

    def depth(time_s):
        return 0.006 + 0.005 * np.sin(2 * np.pi * (0.3 * time_s + 0.12 * time_s**2))

    x, earlier = depth(t), depth(t - delay_s)
    speed_then = (depth(t - delay_s + 1e-5) - depth(t - delay_s - 1e-5)) / 2e-5
    force = stiffness * earlier + damping * speed_then + rng.normal(0.0, 0.01, len(t))
    v = np.gradient(x, t)
    data = ChannelData(
        *("contact", ChannelKind.CONTACT, t, x, v, np.gradient(v, t), force),
        *(np.arange(len(t)) // 1000, np.full(len(t), -1)),
    )
    found = fit_model(data, with_effects(PRESS, "delay"), {"delay.time": start_s}).solution.parameters
    assert found["delay.time"] == pytest.approx(delay_s, rel=0.01)
    assert found["damping.c"] == pytest.approx(damping, rel=0.03)


@pytest.mark.parametrize("offset_m", [0.0, -0.002])
def test_fit_excludes_the_contact_boundaries_of_its_own_parameters(offset_m):
    """A dead band moves the apparent surface by millimeters, far from where a fit begins."""
    data = session(2)
    data = replace(data, effort=np.sign(data.effort) * np.maximum(np.abs(data.effort) - 2.0, 0.0))
    model = MODEL.with_effect(EFFECTS["contact_offset"]())
    fit = fit_model(data, model, {"contact_offset.offset": offset_m})
    own = fit_problem(block_average(data), model, fit.solution.parameters)
    np.testing.assert_array_equal(fit.problem.blocked.trusted, own.blocked.trusted)


def test_model_that_places_all_samples_at_the_boundary_is_judged_on_all():
    """A tool as soft as the whole press leaves no depth for the object, and would leave no error."""
    depth, run = np.tile(np.linspace(1e-3, 5e-3, 200), 4), np.repeat(np.arange(4), 200)
    data = channel(K * depth, 0.01 * np.arange(800), depth, np.full(800, 0.002), run)
    blocks, model = block_average(data), with_effects(PRESS, "tool_compliance")
    soft, stiff = (
        fit_problem(blocks, model, {"tool_compliance.compliance": share / K}) for share in (1.0, 0.1)
    )
    assert soft.used.sum() == stiff.used.sum() == blocks.trusted.sum()
