"""Fit at given inner parameters, against numpy and scipy: fixed, weighted, colored, bounded, nonlinear."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from palpate.estimation.channel import ChannelKind, Information, SharedGains
from palpate.estimation.effect import AdditiveEffect
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import FitProblem, residual_slopes, solve_gains
from palpate.estimation.fit.normal_equations import (
    WHITE,
    ArNoise,
    NormalEquations,
    held_out_sse,
    solve_normal_equations,
)
from palpate.estimation.model import Model
from tests.estimation.contact_data import channel

COUNT = 240
RNG = np.random.default_rng(4)
COLUMNS = RNG.normal(size=(COUNT, 3)) * [1.0, 20.0, 0.1]
TARGET = COLUMNS @ [2.0, -0.1, 5.0] + RNG.normal(size=COUNT)


def problem(data=None, *, trusted=None, weights=None, noise_model=WHITE, block=1):
    """Blocks of a channel of six runs, three folds."""
    data = pressed() if data is None else data
    rows = np.arange(len(data)).reshape(-1, block)
    run = data.run[rows[:, 0]]
    trusted = np.ones(len(rows), dtype=np.bool_) if trusted is None else trusted
    return FitProblem(BlockedData(data, rows, run, run % 3, trusted), noise_model, weights)


def pressed(force=lambda x, v: 100.0 * x, kind=ChannelKind.CONTACT, count=COUNT, noise=0.02):
    t, run = np.arange(count) * 0.01, np.repeat(np.arange(6), count // 6)
    x, v = np.sin(7.0 * t + run), 7.0 * np.cos(7.0 * t + run)
    effort = force(x, v) + noise * np.random.default_rng(1).normal(size=count)
    return channel(effort, x, v, t, kind=kind, run=run)


class Counterweight(AdditiveEffect):
    """Effort that is known, beside a gain."""

    name, signals, channels, gains = "counterweight", ("position",), frozenset(), EFFECTS["bias"].gains

    def columns(self, data, inner):
        return np.ones((len(data), 1))

    def known(self, data, inner):
        return 5.0 * data.position**2


def model(*names):
    return Model(
        "m", tuple(Counterweight() if name == "counterweight" else EFFECTS[name]() for name in names)
    )


def test_scored_blocks_are_fitted_and_each_fold_is_left_out():
    some = np.arange(COUNT) % 7 > 0
    one = problem(trusted=some)
    found = one.solve(COLUMNS, TARGET)
    assert found.gains == pytest.approx(np.linalg.lstsq(COLUMNS[some], TARGET[some], rcond=None)[0], rel=1e-6)
    for number, gains in enumerate(found.fold_gains):
        train, out = (some & (one.blocked.fold != number), some & (one.blocked.fold == number))
        own = np.linalg.lstsq(COLUMNS[train], TARGET[train], rcond=None)[0]
        assert gains == pytest.approx(own, rel=1e-6)
        left = (TARGET - COLUMNS @ own) ** 2
        assert found.held_out[number] == pytest.approx(left[out].sum(), rel=1e-6)
        assert found.train[number] == pytest.approx(left[train].sum(), rel=1e-6)
    assert found.dof == some.sum()
    variance = np.linalg.inv(COLUMNS[some].T @ COLUMNS[some]) * found.sse.sum() / (found.dof - 3)
    assert found.standard_errors == pytest.approx(np.sqrt(np.diag(variance)), rel=1e-6)
    assert len(found.held_out) == len(found.fold_gains) == one.blocked.folds == 3


@pytest.mark.parametrize("held", [{"b": 0.3}, {"a": 1.0, "c": -2.0}])
def test_fixed_gain_is_subtracted_and_has_no_error(held):
    names, known = ["a", "b", "c"], np.array([held.get(n, 0.0) for n in "abc"])
    free = [i for i, name in enumerate(names) if name not in held]
    found = problem().solve(COLUMNS, TARGET, names, held)
    rest = problem().solve(COLUMNS[:, free], TARGET - COLUMNS @ known)
    for gains, others in ((found.gains, rest.gains), *zip(found.fold_gains, rest.fold_gains, strict=True)):
        assert gains[free] == pytest.approx(others)
        assert [gains[i] for i in range(3) if i not in free] == list(held.values())
    assert found.standard_errors[free] == pytest.approx(rest.standard_errors, rel=0.02)
    assert [found.standard_errors[i] for i in range(3) if i not in free] == [0.0] * len(held)
    assert found.held_out == pytest.approx(rest.held_out)


def test_irrelevant_fixed_values_change_nothing_and_weights_scale_residuals():
    found = problem().solve(COLUMNS, TARGET, ["a", "b", "c"], {"z": 1.0})
    assert found.gains == pytest.approx(problem().solve(COLUMNS, TARGET).gains, rel=1e-12)
    weights = RNG.uniform(0.0, 2.0, COUNT)
    expected = np.linalg.lstsq(COLUMNS * weights[:, None], TARGET * weights, rcond=None)[0]
    assert problem(weights=weights).solve(COLUMNS, TARGET).gains == pytest.approx(expected, rel=1e-6)


def test_colored_noise_is_weighted_by_innovations():
    memory, one = np.array([0.7, 0.1]), problem(noise_model=ArNoise(np.array([0.7, 0.1])))
    rows = [i for i in range(COUNT) if i % 40 >= 2]
    new = [s[rows] - memory[0] * s[np.subtract(rows, 1)] - memory[1] * s[np.subtract(rows, 2)]
           for s in (COLUMNS, TARGET)]  # fmt: skip
    assert one.solve(COLUMNS, TARGET).gains == pytest.approx(np.linalg.lstsq(*new, rcond=None)[0], rel=1e-6)
    assert one.whiten(TARGET) == pytest.approx(new[1])
    assert np.flatnonzero(one.used).tolist() == rows


SHARED = ("m.c", "m.a")  # in another order than the model has them


@pytest.mark.parametrize(
    ("names", "noise_model", "counts"),
    [
        (["m.a", "m.b", "m.c"], WHITE, True),
        (["m.a", "m.b", "m.d"], WHITE, False),  # it has not all of them
        (["m.a", "m.b", "m.c"], ArNoise(np.zeros(1)), False),
        (["m.a", "m.c"], WHITE, True),
    ],
)
def test_shared_gain_information_is_matched_by_name(names, noise_model, counts):
    rows = RNG.normal(size=(50, 2))
    told = rows @ [7.0, -3.0]
    information = Information(np.tile(rows.T @ rows, (4, 1, 1)), np.tile(rows.T @ told, (4, 1)))
    data = replace(pressed(), shared=SharedGains(SHARED, information))
    one = problem(data, noise_model=noise_model)
    place = ["abc".find(name[-1]) for name in names]  # -1 for one that is not shared
    own = np.column_stack([COLUMNS[:, max(one, 0)] for one in place])
    more = np.column_stack([rows[:, 1], np.zeros(50), rows[:, 0]])[:, np.maximum(place, 0)]
    for columns in (own, np.column_stack([own, COLUMNS[:, 1] ** 2])):  # a signal beside the gains with names
        others = np.zeros((50 if counts else 0, columns.shape[1]))
        others[:, : len(names)] = more[: len(others)]
        both = np.vstack([columns[one.used], others]), np.append(TARGET[one.used], told[: len(others)])
        expected = np.linalg.lstsq(*both, rcond=None)[0]
        assert one.solve(columns, TARGET, names).gains == pytest.approx(expected, rel=1e-6)


def test_unexcited_column_gets_the_shared_value():
    information = Information(np.full((4, 1, 1), 5.0), np.full((4, 1), 10.0))
    nothing = np.zeros((3, 2, 2))
    nothing[:, 1, 1] = 1.0
    assert solve_normal_equations(NormalEquations(nothing, information)).gains == pytest.approx([2.0])
    assert solve_normal_equations(NormalEquations(nothing)).gains == pytest.approx([0.0])


def test_shared_gain_information_applies_with_a_fixed_gain():
    """As if the others' rows stood below these, all less what the fixed gain makes of them."""
    rows, effort = RNG.normal(size=(40, 3)), RNG.normal(size=40)
    known = Information(np.repeat((rows.T @ rows)[None], 2, axis=0), np.repeat((rows.T @ effort)[None], 2, 0))
    both = np.column_stack([COLUMNS, TARGET])
    fixed = np.array([False, True, False])
    equations = NormalEquations((both.T @ both)[None], known).with_fixed(fixed, np.array([0.0, 3.0, 0.0]))
    stacked, target = np.vstack([COLUMNS, rows]), np.concatenate([TARGET, effort])
    expected = np.linalg.lstsq(stacked[:, ~fixed], target - 3.0 * stacked[:, 1], rcond=None)[0]
    np.testing.assert_allclose(np.linalg.solve(*equations.systems(np.ones(2))), expected)


@pytest.mark.parametrize("count", [3, 4])
def test_saturated_regression_has_unknown_errors(count):
    found = problem(trusted=np.arange(COUNT) < count).solve(COLUMNS, TARGET)
    assert np.isnan(found.standard_errors).all() == (count == 3)


def test_equations_without_columns_leave_the_whole_error():
    target = TARGET[:, None]
    equations = NormalEquations(np.stack([part.T @ part for part in np.split(target, 3)]))
    assert held_out_sse(equations, np.empty((1, 0)))[0] == pytest.approx(equations.products[:, 0, 0])
    assert solve_normal_equations(equations).held_out == pytest.approx(equations.products[:, 0, 0])


def scipy_gains(one, made, data, known):
    """Gains that scipy finds for the same blocks, the inner parameters known."""

    def residual(gains):
        parameters = {**known, **dict(zip(made.gains, gains, strict=True))}
        return one.blocked.reduce(data.effort - made.predict(data, parameters))

    best = least_squares(residual, np.ones(len(made.gains)), x_scale="jac", xtol=1e-14, ftol=1e-14)
    return best.x, 2.0 * best.cost


CASES = {
    "a joint": ("revolute", ("stiffness", "damping"), lambda x, v: 3.0 * x + 0.5 * v, {}, 1e-6),
        "a joint with effort that is known": (
        "revolute",
        ("stiffness", "counterweight", "torque_gain"),
        lambda x, v: 1.5 * (3.0 * x + 5.0 * x**2 + 0.2),
        {"torque_gain.gain": 1.5},
        1e-6,
    ),
    "an object that can only push": ("contact", ("stiffness", "damping"),
                                     lambda x, v: np.maximum(3.0 * x + 0.3 * v, 0.0) * (x > 0), {}, 1e-3),
    "a surface elsewhere": ("contact", ("stiffness", "damping", "contact_offset"),
                            lambda x, v: np.maximum(3.0 * (x - 0.1) + 0.3 * v, 0.0) * (x > 0.1),
                            {"contact_offset.offset": 0.1}, 1e-3),
    "a sensor with an end": ("revolute", ("stiffness", "damping", "saturation"),
                             lambda x, v: np.clip(3.0 * x + 0.5 * v, -2, 2), {"saturation.limit": 2.0}, 1e-2),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_gains_match_scipy_for_the_whole_model(name):
    kind, effects, force, inner, near = CASES[name]
    data, made = pressed(force, ChannelKind(kind), 2400), model(*effects)
    one = problem(data, block=2)
    found = solve_gains(one, made, inner, rounds=9)
    gains, energy = scipy_gains(one, made, data, inner)
    assert [found.parameters[n] for n in made.gains] == pytest.approx(gains.tolist(), rel=near, abs=near)
    assert {n: found.parameters[n] for n in inner} == inner
    assert float(found.residual @ found.residual) == pytest.approx(energy, rel=0.02)
    assert found.standard_errors.keys() == made.gains.keys()
    fold = one.blocked.fold
    assert found.held_out == pytest.approx(found.linear_fit.held_out.sum())
    own = np.linalg.lstsq(found.columns[fold != 1], found.target[fold != 1], rcond=None)[0]
    left = (found.target - found.columns @ own)[fold == 1]
    assert found.linear_fit.held_out[1] == pytest.approx(left @ left, rel=1e-5)


@pytest.mark.parametrize(
    ("effects", "how", "looks"),
    [
        (("stiffness", "saturation"), {}, 3),  # two steps, and a look whether the last led where it was to
        (("stiffness", "saturation"), {"rounds": 4}, 5),
        (("stiffness", "saturation"), {"max_ratio": 0.0}, 7),  # at most
        (("stiffness", "delay"), {}, 0),  # linear: its columns are known on blocks
    ],
)
def test_gains_iterate_until_convergence_with_a_nonlinear_sensor(effects, how, looks, monkeypatch):
    data = pressed(lambda x, v: np.clip(10.0 * x, -2.0, 2.0), ChannelKind.REVOLUTE)
    seen, plain = [], Model.linearize
    monkeypatch.setattr(Model, "linearize", lambda *args: seen.append(1) or plain(*args))
    solve_gains(problem(data), model(*effects), {"saturation.limit": 2.0, "delay.time": 0.013}, **how)
    assert len(seen) == looks


def test_given_parts_are_used_and_a_solution_without_blocks_is_equal():
    data, made = pressed(), model("stiffness", "damping")
    one = problem(data)
    whole = solve_gains(one, made, {})
    parts = made.parts(data, {})
    again = solve_gains(one, made, {}, parts=(2.0 * parts[0], parts[1]))
    assert again.parameters["stiffness.k"] == pytest.approx(0.5 * whole.parameters["stiffness.k"], rel=1e-6)
    less = whole.without_blocks()
    assert (less.sse, less.held_out, less.parameters) == (whole.sse, whole.held_out, whole.parameters)
    assert (less.columns.shape, less.target.shape) == ((0, 2), (0,))


@pytest.mark.parametrize("seed", range(8))
def test_gains_within_bounds_match_scipy(seed):
    """Columns that resemble each other: gains at a bound may leave it again once others are there."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(COUNT, 5)) @ (np.eye(5) + 0.6 * rng.normal(size=(5, 5)))
    columns *= [1.0, 1e3, 1e-3, 1.0, 1.0]
    target = columns @ (rng.normal(size=5) / [1.0, 1e3, 1e-3, 1.0, 1.0]) + rng.normal(size=COUNT)
    lower, upper = rng.choice([-np.inf, 0.0, -0.5, 0.1], 5), rng.choice([np.inf, 0.6, 1.0], 5)
    lower[4], upper[4] = -np.inf, np.inf  # a column without a name
    bounds = {name: (lower[i], upper[i]) for i, name in enumerate("abcd")}
    expected = lsq_linear(columns / [1, 1e3, 1e-3, 1, 1], target, (lower * [1, 1e3, 1e-3, 1, 1],
                          upper * [1, 1e3, 1e-3, 1, 1]), tol=1e-13).x / [1, 1e3, 1e-3, 1, 1]  # fmt: skip
    found = problem().solve(columns, target, list("abcd"), bounds=bounds)
    assert found.gains == pytest.approx(expected, rel=1e-4, abs=1e-6 / 1e3)
    assert np.all((found.gains >= lower) & (found.gains <= upper))
    fixed = np.isin(found.gains, [*lower, *upper])
    assert (found.standard_errors == 0.0).tolist() == fixed.tolist()
    for number, gains in enumerate(found.fold_gains):
        rows = problem().blocked.fold != number
        rest = target[rows] - columns[np.ix_(rows, fixed)] @ found.gains[fixed]
        free = np.linalg.lstsq(columns[np.ix_(rows, ~fixed)], rest, rcond=None)[0]
        assert gains[~fixed] == pytest.approx(free, rel=1e-5)
        assert gains[fixed].tolist() == found.gains[fixed].tolist()


def test_gain_at_its_bound_is_fixed_and_marked():
    driven = pressed(lambda x, v: 3.0 * x - 0.5 * v, ChannelKind.REVOLUTE)
    found = solve_gains(problem(driven), model("stiffness", "damping"), {})
    assert found.parameters["damping.c"] == 0.0
    assert found.fixed == {"damping.c"}
    assert found.parameters["stiffness.k"] == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("kind", [ChannelKind.CONTACT, ChannelKind.PRISMATIC])
def test_residual_slopes_are_those_of_refitted_gains(kind):
    """At the truth and without noise the projected slopes are exact."""
    names, inner, true = (
        (("stiffness", "exponential_stiffness"), "exponential_stiffness.b", 3.0)
        if kind is ChannelKind.CONTACT
        else (("stiffness", "saturation"), "saturation.limit", 40.0)
    )
    step = 1e-5
    made = model(*names)
    data = pressed(kind=kind, noise=0.0)
    gains = dict.fromkeys(made.gains, 50.0)
    one = problem(replace(data, effort=made.predict(data, {**gains, inner: true})))
    solution = solve_gains(one, made, {**gains, inner: true}, rounds=9)
    ahead = solve_gains(one, made, {**solution.parameters, inner: true + step}, rounds=9)
    expected = one.whiten(ahead.residual - solution.residual)
    found = residual_slopes(one, solution, {inner: true + step})[:, 0]
    assert np.abs(expected).max() > 1e-9
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
