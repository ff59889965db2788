"""Next trial of a search along one inner parameter."""

from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effect import AdditiveEffect, Parameter
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit import inner_search
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.inner_search import (
    GridSearch,
    _midpoints,
    _parabola_minimum,
    _Scale,
    optimize_inner,
    refine_inner,
    search_inner,
)
from palpate.estimation.model import Model
from tests.estimation.fit.test_fit_problem import pressed, problem
from tests.estimation.presses import channel


@pytest.mark.parametrize(
    ("values", "best", "log", "expected"),
    [
        ([1.0, 2.0, 4.0, 8.0], 1, False, [1.5, 3.0]),
        ([1.0, 2.0, 4.0, 8.0], 2, False, [3.0, 6.0]),
        ([1.0, 4.0, 16.0], 1, True, [2.0, 8.0]),
        ([1.0, 4.0, 16.0], 0, True, [2.0]),
        ([10.0, 40.0, 100.0], 2, False, [70.0]),
        # where the grid ends, twice as far outside as its last step was wide
        ([10.0, 20.0], 1, False, [15.0, 40.0]),
        ([40.0, 50.0], 0, False, [20.0, 45.0]),
        ([1.0, 2.0, 4.0], 2, True, [8.0**0.5, 16.0]),
        ([16.0, 32.0], 0, True, [4.0, 512.0**0.5]),
        ([5.0], 0, False, [1.0, 100.0]),
    ],
)
def test_midpoints_to_both_neighbors_stay_within_bounds(values, best, log, expected):
    inner = Parameter("width", "m", 1.0, 100.0, (2.0, 50.0), log=log)
    assert _midpoints(values, best, inner) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("values", "cost", "log", "expected"),
    [
        ([1.0, 2.0, 8.0], lambda x: (x - 3.0) ** 2, False, 3.0),
        ([1.0, 2.0, 8.0], lambda x: 7.0 + 0.1 * (x - 1.5) ** 2, False, 1.5),
        ([1.0, 4.0, 32.0], lambda x: np.log(x / 5.0) ** 2, True, 5.0),
        ([1.0, 2.0, 3.0], lambda x: x, False, None),  # no bend
        ([1.0, 2.0, 8.0], lambda x: 8.0 - (x - 3.0) ** 2, False, None),  # a summit
    ],
)
def test_parabola_minimum_is_tried(values, cost, log, expected):
    inner = Parameter("width", "m", 1.0, 100.0, (2.0, 50.0), log=log)
    lowest = _parabola_minimum(values, [cost(value) for value in values], inner)
    assert lowest == pytest.approx([] if expected is None else [expected])


def test_each_fold_is_judged_at_inner_parameters_of_the_others():
    def solution(train, held_out):
        return SimpleNamespace(sse=sum(train), linear_fit=SimpleNamespace(train=train, held_out=held_out))

    tried = GridSearch((solution([1.0, 5.0, 3.0], [10, 20, 30]), solution([2.0, 4.0, 3.5], [1, 2, 3])), 1)
    assert tried.held_out.tolist() == [10, 2, 30]
    assert tried.starts == tried.solutions[:1]
    assert tried.best is tried.solutions[0]


@pytest.mark.parametrize(
    ("start", "log", "value", "number"),
    [
        (5.0, True, 10.0, np.log(2.0)),  # by ratio
        (5.0, False, 10.0, 1.0),  # by difference, in units of the start
        (-5.0, True, -10.0, -1.0),
        (0.0, True, 4.8, 0.1),  # or of the typical range where it begins at nothing
        (0.0, False, -4.8, -0.1),
    ],
)
def test_search_variables_are_of_order_one(start, log, value, number):
    scale = _Scale(Parameter("width", "m", -100.0, 100.0, (2.0, 50.0), log=log), start)
    assert scale.number(value) == pytest.approx(number)
    assert scale.value(number) == pytest.approx(value)
    assert scale.number(start) == 0.0
    assert scale.bounds == (scale.number(-100.0), scale.number(100.0))


class Tried(SimpleNamespace):
    """A trial that keeps its blocks until it is told not to."""

    def without_blocks(self):
        return Tried(**{**vars(self), "blocks": False})


def searched(monkeypatch, cost, *inner, starts):
    """A search of the lowest cost: what `look` and `refine` tried."""

    def attempt(problem, model, parameters, rounds, parts):
        assert parts == "parts"
        here = {name[2:]: value for name, value in parameters.items() if name.startswith("e.")}
        assert parameters["other.x"] == 5.0
        return Tried(sse=cost(**here), parameters=dict(parameters), blocks=True, model=model)

    monkeypatch.setattr(inner_search, "solve_gains", attempt)
    monkeypatch.setattr(inner_search, "linearize_inner", lambda *args: lambda there: "parts")
    problem = SimpleNamespace(blocked=SimpleNamespace(data=None))
    model = SimpleNamespace(effect=lambda name: SimpleNamespace(name=name, inner=inner))
    looked = search_inner(problem, model, "e", {"other.x": 5.0}, starts)
    return looked, refine_inner(problem, "e", looked)


WIDTH = Parameter("width", "m", 1.0, 100.0, (2.0, 50.0), log=True)
SHIFT = Parameter("shift", "m", -10.0, 10.0, (-5.0, 5.0))
WIDTHS = [{"width": value} for value in (2.0, 4.0, 8.0, 16.0, 32.0)]


@pytest.mark.parametrize("lowest", [1.2, 3.0, 5.7, 22.0, 60.0])
@pytest.mark.parametrize("sharp", [0.5, 2.0])
def test_line_search_finds_the_minimum_in_few_trials(monkeypatch, lowest, sharp):
    def cost(width):
        return abs(np.log(width / lowest)) ** (2.0 * sharp) * (1.0 + 0.2 * width / lowest)

    looked, refined = searched(monkeypatch, cost, WIDTH, starts=WIDTHS)
    assert [one.parameters["e.width"] for one in looked.solutions] == [one["width"] for one in WIDTHS]
    assert refined.solutions[:5] == tuple(refined.starts)
    assert refined.best.parameters["e.width"] == pytest.approx(lowest, rel=0.02 if sharp == 2.0 else 0.1)
    assert 5 < len(refined.solutions) - 5 <= 12
    assert [one.blocks for one in refined.solutions] == [one is refined.best for one in refined.solutions]
    assert not any(one.blocks for one in refined.without_blocks().solutions)


def test_two_parameters_are_searched_alternately_twice(monkeypatch):
    """Where the one is best depends on the other."""
    grid = [{"width": w, "shift": s} for w in (2.0, 8.0, 32.0) for s in (-5.0, 0.0, 5.0)]

    def cost(width, shift):
        return (np.log(width / 6.0)) ** 2 + 0.1 * (shift - 2.0 + 0.5 * np.log(width / 6.0)) ** 2

    looked, refined = searched(monkeypatch, cost, WIDTH, SHIFT, starts=grid)
    best = refined.best.parameters
    assert best["e.width"] == pytest.approx(6.0, rel=0.15)
    assert best["e.shift"] == pytest.approx(2.0, abs=0.2)
    assert refined.start_count == len(looked.solutions) == 9


def test_single_start_value_is_not_refined(monkeypatch):
    looked, refined = searched(monkeypatch, lambda width: width, WIDTH, starts=WIDTHS[:1])
    assert refined.solutions == looked.solutions
    assert refined.best.blocks


class Power(AdditiveEffect):
    """A law that is known only for exponents within their bounds."""

    name, signals, gains = "power", ("position",), EFFECTS["bias"].gains
    inner = (Parameter("n", "1", 1.0, 2.0, (1.2, 1.8)),)

    def columns(self, data, inner):
        assert 1.0 <= inner["n"] <= 2.0
        return np.abs(data.position[:, None]) ** inner["n"]


def test_law_is_never_evaluated_beyond_the_bounds_of_its_parameters():
    one = problem(pressed(lambda x, v: 50.0 * np.abs(x) ** 3, ChannelKind.REVOLUTE))
    found = optimize_inner(one, solve_gains(one, Model("m", (Power(),)), {"power.n": 1.9}))
    assert found.parameters["power.n"] == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize(("held", "time_s"), [({}, 0.03), ({"delay.time": 0.01}, 0.01)])
def test_held_delay_keeps_its_value_even_beside_a_damping_at_its_bound(held, time_s):
    """Without the delay, the late force of a spring looks like a negative damping."""
    data = pressed(lambda x, v: 100.0 * (x - 0.03 * v), ChannelKind.REVOLUTE)
    model = Model("m", tuple(EFFECTS[name]() for name in ("stiffness", "damping", "delay")), held=held)
    one = problem(data)
    start = solve_gains(one, model, {"delay.time": 0.01})
    assert start.fixed >= {"damping.c"}
    assert optimize_inner(one, start).parameters["delay.time"] == pytest.approx(time_s, abs=2e-3 * (not held))


def test_parameter_that_begins_at_its_bound_is_released():
    """Share and exponent of a power law depend on each other: a step inside helps only if it is small."""
    t = np.arange(0.0, 240.0, 0.5)
    x = 0.004 * np.clip(t / 3.0, 0.0, 1.0) * (t < 200.0)
    ages = t[:, None] - t[None, :] + 0.25
    faded = np.where(ages > 0.0, np.maximum(ages, 0.25) ** -0.25, 0.0) @ np.diff(x, prepend=0.0)
    force = 900.0 * (0.45 * x + 0.55 * faded)
    force = np.where(x > 0.0, np.maximum(force, 0.0), 0.0)
    force += np.random.default_rng(2).normal(0.0, 0.004, len(t))
    data = channel(
        np.tile(force, 2),
        np.concatenate([t, t + 900.0]),
        *(np.tile(s, 2) for s in (x, np.gradient(x, 0.5))),
        np.repeat([0, 1], len(t)),
    )
    model = Model("m", tuple(EFFECTS[name]() for name in ("stiffness", "power_law_relaxation")))
    fits = [
        fit_model(data, model, {"power_law_relaxation.share": share, "power_law_relaxation.alpha": alpha})
        for share, alpha in ((0.5, 0.25), (1.0, 0.09))
    ]
    assert fits[1].solution.sse == pytest.approx(fits[0].solution.sse, rel=1e-4)
    assert fits[1].solution.parameters["power_law_relaxation.share"] == pytest.approx(0.55, abs=0.05)


@pytest.mark.parametrize(("exponent", "expected"), [(1.006, 1.0), (1.008, 1.0034)])
def test_parameter_keeps_its_bound_unless_the_error_falls_noticeably(exponent, expected):
    one = problem(pressed(lambda x, v: 50.0 * np.abs(x) ** exponent, ChannelKind.REVOLUTE, noise=2.0))
    found = optimize_inner(one, solve_gains(one, Model("m", (Power(),)), {"power.n": 1.0}))
    assert found.parameters["power.n"] == pytest.approx(expected, abs=1e-4)
