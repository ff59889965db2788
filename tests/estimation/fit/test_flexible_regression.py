"""Flexible regression: what each signal's basis represents, and its share of noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.blocks import block_average
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.flexible_regression import (
    _fit_ridge,
    _model_features,
    _past_effort,
    _select_signals,
    _smooth_features,
    fit_flexible,
    hats,
)
from palpate.estimation.fit.normal_equations import gram_matrices, nuisance_of
from palpate.estimation.model import Model
from palpate.estimation.signals.exponential_memory import low_pass
from palpate.estimation.signals.runwise import derivative, play, shift
from tests.estimation.fit.test_fit_problem import COLUMNS, COUNT, TARGET, problem
from tests.estimation.presses import kelvin_voigt
from tests.estimation.presses import long_session as session
from tests.estimation.swings import NOISE_NM
from tests.estimation.swings import long_swings as swings

MEASURED = ((), ())  # velocity and acceleration were not derived
SWING = Model("pendulum", (EFFECTS["pendulum"](), EFFECTS["viscous_friction"]()))
CONTEXT = {"load": 0.3, "temperature": 1.0, "time": 2.0}
SWUNG = swings(1, rate_hz=100.0)
SWUNG = replace(SWUNG, context={n: np.sin(s * SWUNG.time_s + s) + 2.0 for n, s in CONTEXT.items()},
                recorded=frozenset({"temperature", "time"}))  # fmt: skip
PRESSED = session(1)


def signals(data):
    """Signals of a channel on blocks, as laws below have them, with the effort that is expected."""
    blocked = block_average(data)
    names = ("time_s", "position", "velocity", "acceleration")
    t, x, v, a = (blocked.reduce(getattr(data, name)) for name in names)
    e = blocked.reduce(data.effort)
    direction = turned(v, 0.02)
    since = t - np.array([t[blocked.run == run][0] for run in blocked.run])
    done = np.cumsum(np.abs(e * v))
    own = {"t": t, "x": x, "v": v, "a": a, "e": e, "s": direction, "run": blocked.run}
    own |= {"since": since, "work": done}
    own |= {name: blocked.reduce(data.context[name]) for name in data.context}
    return blocked, own


def turned(v, share):
    return np.tanh(v / (share * np.sqrt(np.mean(v**2))))


def bent(signal):
    return signal * np.abs(signal)


def fades(x, t, run, tau):
    return x - low_pass(x, t, run, tau)


def late(e, t, run, blocks):
    return shift(e, t, run, 0.01 * blocks)


def way(x, run, share):
    """Towards which side a gap, a share of the range wide, was crossed last."""
    return x - play(x, run, share * np.ptp(x))


LAWS = {  # of a joint: which signal's columns draw it; those that begin with "about" bend between its knots
    "a constant": ("offset", lambda o: 1.0 + 0 * o.x),
    "a trend": ("time", lambda o: o.t),
    "a trend that bends": ("time", lambda o: o.t**2),
    "warming up in each run": ("time", lambda o: o.since),
    "damping that ages": ("time", lambda o: o.t * o.v),
    "damping that ages in each run": ("time", lambda o: o.since * o.v),
    "friction that wears by work": ("time", lambda o: o.work * o.s),
    "a gain that fades": ("time", lambda o: o.t * o.e),
    "about a kink": ("position", lambda o: np.abs(o.x - 0.3)),
    "a ripple": ("position", lambda o: np.sin(2 * np.pi * 7 * o.x / np.ptp(o.x) + 1)),
    "a fine ripple": ("position", lambda o: np.cos(2 * np.pi * 24 * o.x / np.ptp(o.x))),
    "a spring that stiffens": ("position", lambda o: o.x**3),
    "drag": ("velocity", lambda o: o.v * np.abs(o.v)),
    "drag by the cube": ("velocity", lambda o: o.v**3),
    "about damping by place": ("velocity", lambda o: o.v * np.abs(o.x)),
    "dry friction": ("direction", lambda o: o.s),
    "about friction by place": ("direction", lambda o: o.s * np.abs(o.x)),
    "about friction by load": ("direction", lambda o: o.s * np.abs(o.e)),
    "about a mass that is not constant": ("acceleration", lambda o: np.abs(o.a)),
    "creep": ("past motion", lambda o: fades(o.x, o.t, o.run, 0.1)),
    "slow creep": ("past motion", lambda o: fades(o.x, o.t, o.run, 1.0)),
    "hysteresis": ("past motion", lambda o: way(o.x, o.run, 0.04)),
    "a rate": ("effort", lambda o: derivative(o.e, o.t, o.run)),
    "creep that bends": ("past motion", lambda o: bent(fades(o.x, o.t, o.run, 0.3))),
    "hysteresis by depth": ("past motion", lambda o: np.abs(way(o.x, o.run, 0.01)) * o.x),
    "hysteresis of a reader": ("effort", lambda o: way(o.e, o.run, 0.15)),
    "sharp friction": ("direction", lambda o: turned(o.v, 0.004)),
    "a late reading": ("effort", lambda o: o.e - late(o.e, o.t, o.run, 3.0)),
    "a smoothed reading": ("effort", lambda o: o.e - low_pass(o.e, o.t, o.run, 0.1)),
    "a gain": ("effort", lambda o: o.e),
    "about saturation": ("effort", lambda o: np.clip(o.e, -1.0, 1.0)),
    "its cube": ("effort", lambda o: o.e**3),
    "friction by a load that is known": ("load", lambda o: turned(o.v, 0.004) * o.load),
    "about a kink of the load": ("load", lambda o: np.abs(o.load - 2.0)),
    "about warmth": ("temperature", lambda o: o.temperature**2),
    "damping by warmth": ("temperature", lambda o: o.v * (o.temperature - o.temperature.mean())),
    "stiffness by warmth": ("temperature", lambda o: o.x * (o.temperature - o.temperature.mean())),
    "a gain by a clock of one's own": ("recorded time", lambda o: o.e * (o.time - o.time.mean())),
}  # fmt: skip


def left(columns, law):
    """Share of a law's energy about its mean that the columns do not draw."""
    columns = np.column_stack([np.ones(len(law)), columns])
    return np.var(law - columns @ np.linalg.lstsq(columns, law, rcond=None)[0]) / max(np.var(law), 1e-12)


@pytest.fixture(scope="module")
def swung():
    blocked, own = signals(SWUNG)
    return own, _smooth_features(blocked, [own["e"]])


@pytest.mark.parametrize("name", LAWS)
def test_law_of_a_signal_is_represented_by_its_columns(swung, name):
    own, columns = swung
    signal, law = LAWS[name]
    law = law(SimpleNamespace(**own))
    assert left(columns[signal], law) < (
        0.02 if name.startswith("about") else 1e-5 if signal == "past motion" else 1e-6
    )
    assert all(np.isfinite(one).all() and len(one) == len(law) for one in columns.values())
    if signal in {"recorded time", "load", "temperature", "acceleration"}:
        assert left(columns["velocity"], law) > 0.1


PRESS_LAWS = {
    "creep": ("past motion", lambda o: low_pass(np.maximum(o.x, 0), o.t, o.run, 0.3) * (o.x > 0)),
    "a film that sticks": (
        "past motion",
        lambda o: np.exp(o.x / (0.06 * o.x.max())) * o.touched * (o.x <= 0),
    ),
    "a spring": ("position", lambda o: np.maximum(o.x, 0)),
    "a layer": ("position", lambda o: np.maximum(o.x - 0.006, 0)),
    "what was pressed flat": ("position", lambda o: o.furthest),
    "damping": ("velocity", lambda o: o.v * (o.x > 0)),
}


@pytest.mark.parametrize("name", PRESS_LAWS)
def test_contact_law_covers_the_touched_depth(name):
    blocked, own = signals(PRESSED)
    columns = _smooth_features(blocked, [own["e"]])
    own["furthest"] = np.concatenate([np.maximum.accumulate(own["x"][own["run"] == r]) for r in range(6)])
    own["touched"] = own["furthest"] > 0
    signal, law = PRESS_LAWS[name]
    law = law(SimpleNamespace(**own))
    assert left(columns[signal], law) < 0.02
    before = (own["furthest"] < -1e-4) & (own["x"] < -1e-4)
    assert not columns["past motion"][before].any()  # nothing is remembered of free air
    assert not columns["velocity"][before].any() or "velocity" not in name


@pytest.mark.parametrize("low", [-1.0, 0.5])
def test_basis_represents_any_kinked_line_without_a_constant(low):
    values = np.sort(np.random.default_rng(1).uniform(low, 2.0, 400))
    bumps = hats(values)
    assert (bumps >= 0.0).all()
    assert bumps.sum(axis=1).max() == pytest.approx(1.0)
    nearest = np.argmin(np.abs(values))
    assert bumps[nearest].sum() < 0.1  # of the knot at zero, or nearest to it, none is left
    assert 10 < bumps.shape[1] < 22
    assert hats(np.full(10, low)).shape == (10, 1)
    crowded = np.append(np.zeros(900), np.linspace(0.0, 1.0, 100))
    assert np.linalg.cond(np.column_stack([np.ones(1000), hats(crowded)])) < 1e4
    dense = np.append(np.linspace(0.2, 0.4, 900), np.linspace(0.0, 1.0, 100))  # knots follow the samples
    assert left(hats(dense), np.sin(2.0 * np.pi * dense / 0.1) * (dense > 0.2) * (dense < 0.4)) < 0.1


HIDDEN = {  # and a signal that says nothing of it
    "velocity": (lambda q, v, a: 0.2 * np.sin(3.0 * v), "offset"),
    "position": (lambda q, v, a: 0.2 * np.sin(9.0 * q), "offset"),
    "offset": (lambda q, v, a: 0.1 + 0.0 * q, ""),  # bumps of any signal make up most of a constant
}


@pytest.mark.parametrize("name", HIDDEN)
def test_residual_is_explained_by_its_signal(name):
    law, nothing = HIDDEN[name]
    one = fit_model(swings(6, law, rate_hz=100.0), SWING, {})
    found = fit_flexible(one.problem, one.solution, MEASURED)
    assert found.by_signal[name] > 0.98 * max(found.by_signal.values())
    assert found.by_signal[name] > 0.8 > 0.3 > found.by_signal.get(nothing, 0.0)
    count = one.problem.used.sum()
    assert NOISE_NM < np.sqrt(found.held_out.sum() / count) < 0.1  # of 0.14 and the noise
    kept = one.problem.used
    assert np.sum(found.residual[kept] ** 2) == pytest.approx(found.held_out.sum(), rel=0.01)
    assert set(_model_features(one.problem, one.solution)) == set(found.by_signal)


def test_explained_share_of_noise_is_small_and_bounded():
    for data, model in (
        (swings(3, rate_hz=100.0), SWING),
        (session(3), Model("m", (EFFECTS["stiffness"](), EFFECTS["damping"]()))),
    ):
        one = fit_model(data, model, {})
        found = fit_flexible(one.problem, one.solution, MEASURED)
        assert 0.97 * one.solution.held_out < found.held_out.sum() <= (1.0 + 1e-9) * one.solution.held_out
        assert all(share < 0.02 for share in found.by_signal.values())
    exact = session(3, lambda t, x, v, run: kelvin_voigt(x, v))
    exact = replace(exact, effort=np.zeros(len(exact)))
    one = fit_model(exact, Model("m", (EFFECTS["stiffness"](),)), {})
    assert set(fit_flexible(one.problem, one.solution, MEASURED).by_signal.values()) == {0.0}


@pytest.mark.parametrize(
    ("weights", "taken"),
    [
        ((5.0, 4.0, 3.0, 2.0, 1.5), (0, 1, 2, 3)),  # at most four
        ((4.0, 5.0, 0.55, 0.0, 0.0), (1, 0, 2)),
        ((4.0, 5.0, 0.4, 0.0, 0.0), (1, 0)),  # three thousandths of the energy are not worth one more
    ],
)
def test_signals_are_selected_stepwise_where_another_would_mislead(weights, taken):
    """Beside them is one that says the opposite in the second fold: all together do worse."""
    rng, parts = np.random.default_rng(1), []
    for sign in (1.0, -1.0, 1.0):
        x = rng.normal(size=(2000, 6))
        x /= np.sqrt(np.mean(x**2, axis=0))
        parts.append(np.column_stack([x, x @ [*weights, 3.0 * sign] + 0.1 * rng.normal(size=2000)]))
    equations, owner = gram_matrices(parts), np.arange(6)
    alone = [_fit_ridge(equations, owner, (number,)) for number in range(6)]
    assert _select_signals(equations, owner, alone, _fit_ridge(equations, owner, ())).signals == taken


def test_signals_that_explain_only_together_are_selected():
    """Their difference is the target, which is small beside what they share."""
    rng = np.random.default_rng(1)
    shared, target = rng.normal(size=(3, 500)), 0.01 * rng.normal(size=(3, 500))
    equations = gram_matrices(np.stack([shared + target, shared, target], axis=2))
    owner = np.arange(2)
    none, *alone = (_fit_ridge(equations, owner, signals) for signals in ((), (0,), (1,)))
    assert min(fit.energy for fit in alone) > 0.99 * none.energy
    together = _select_signals(equations, owner, alone, none)
    assert together.signals == (0, 1)
    assert together.energy < 0.1 * none.energy


RNG = np.random.default_rng(9)
FLEXIBLE = RNG.normal(size=(COUNT, 4)) + COLUMNS[:, :1]  # not orthogonal to what is fitted
PER_RUN = np.column_stack([np.ones(COUNT), RNG.normal(size=COUNT) + COLUMNS[:, 0]])
NONE = np.empty((COUNT, 0))


@pytest.mark.parametrize("per_run", [NONE, PER_RUN])
@pytest.mark.parametrize("flexible", [NONE, FLEXIBLE, np.column_stack([FLEXIBLE, FLEXIBLE.sum(axis=1)])])
def test_gains_beside_flexible_columns_equal_a_joint_fit(flexible, per_run):
    """Some blocks do not count; a column that others make up takes nothing away."""
    some = np.arange(COUNT) % 7 > 0
    plain = problem(trusted=some)
    run = plain.blocked.run
    projected = replace(plain, nuisance=nuisance_of(flexible, per_run, run, some))
    own = [per_run * (run == number)[:, None] for number in np.unique(run)]
    columns = np.hstack([COLUMNS, flexible, *own])[some]
    expected, *_ = np.linalg.lstsq(columns, TARGET[some], rcond=None)
    found = projected.solve(COLUMNS, TARGET)
    assert found.gains == pytest.approx(expected[:3], rel=1e-6)
    left = TARGET[some] - columns @ expected
    assert found.sse.sum() == pytest.approx(left @ left, rel=1e-6)


def test_flexible_columns_remove_their_part_of_the_error():
    nuisance = nuisance_of(FLEXIBLE, PER_RUN, problem().blocked.run, np.ones(COUNT, dtype=bool))
    assert nuisance.remove(FLEXIBLE @ [1.0, -2.0, 0.5, 3.0]) == pytest.approx(0.0, abs=1e-9)
    assert nuisance.remove(PER_RUN) == pytest.approx(0.0, abs=1e-9)
    once = nuisance.remove(TARGET)
    assert nuisance.remove(once) == pytest.approx(once)


def test_constant_stiction_of_a_sensor_is_a_law_of_its_effort():
    """Its error has the sign of the effort's rate, at slow and at fast changes alike."""
    time_s, run = 1e-3 * np.arange(4000), np.zeros(4000, dtype=int)
    effort = 5.0 * np.sin(2.0 * np.pi * time_s) + 2.0 * np.sin(2.0 * np.pi * 0.37 * time_s)
    stuck = np.sign(np.gradient(effort))
    columns = np.column_stack([_past_effort(effort, time_s, run), effort, np.ones(4000)])
    left = stuck - columns @ np.linalg.lstsq(columns, stuck, rcond=None)[0]
    assert left @ left < 0.03 * (stuck @ stuck)
