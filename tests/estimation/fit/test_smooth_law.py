"""What a law without a name can draw, by the signal that it is a law of; and what it leaves of noise."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.effects import EFFECTS
from estimation.fit.flexible import flexible, signals_of
from estimation.fit.frame import frame_of
from estimation.fit.smooth_signals import _hats, features
from estimation.fit.standing import fit
from estimation.model import Model
from estimation.signals.runwise import low_pass, play, shift
from tests.estimation.presses import kelvin_voigt, session
from tests.estimation.swings import NOISE_NM, swings

SWING = Model("pendulum", (EFFECTS["pendulum"](), EFFECTS["viscous_friction"]()))
CONTEXT = {"load": 0.3, "temperature": 1.0, "time": 2.0}
SWUNG = swings(1, rate_hz=100.0)
SWUNG = replace(SWUNG, context={n: np.sin(s * SWUNG.time_s + s) + 2.0 for n, s in CONTEXT.items()},
                recorded=frozenset({"temperature", "time"}))  # fmt: skip
PRESSED = session(1)


def signals(data):
    """Signals of a channel on blocks, as laws below have them, with the effort that is expected."""
    frame = frame_of(data)
    names = ("time_s", "position", "velocity", "acceleration")
    t, x, v, a = (frame.reduce(getattr(data, name)) for name in names)
    e = frame.reduce(data.effort)
    direction = np.tanh(v / (0.02 * np.sqrt(np.mean(v**2))))
    since = t - np.array([t[frame.run == run][0] for run in frame.run])
    done = np.cumsum(np.abs(e * v))
    own = {
        "t": t,
        "x": x,
        "v": v,
        "a": a,
        "e": e,
        "s": direction,
        "since": since,
        "work": done,
        "run": frame.run,
    }
    own |= {name: frame.reduce(data.context[name]) for name in data.context}
    return frame, own


def fades(x, t, run, tau):
    return x - low_pass(x, t, run, tau)


def late(e, t, run, blocks):
    return shift(e, t, run, 0.01 * blocks)


def way(x, run, share):
    """Towards which side a gap, a share of the range wide, was crossed last."""
    return x - play(x, run, share * np.ptp(x))


LAWS = {  # of a joint: which signal's columns draw it
    "a constant": ("offset", "1.0 + 0 * x"),
    "a trend": ("time", "t"),
    "a trend that bends": ("time", "t**2"),
    "warming up in each run": ("time", "since"),
    "damping that ages": ("time", "t * v"),
    "damping that ages in each run": ("time", "since * v"),
    "friction that wears by work": ("time", "work * s"),
    "a gain that fades": ("time", "t * e"),
    "a kink": ("position", "np.abs(x - 0.3)"),
    "a ripple": ("position", "np.sin(2 * np.pi * 7 * x / np.ptp(x) + 1)"),
    "a fine ripple": ("position", "np.cos(2 * np.pi * 24 * x / np.ptp(x))"),
    "a spring that stiffens": ("position", "x**3"),
    "drag": ("velocity", "v * np.abs(v)"),
    "drag by the cube": ("velocity", "v**3"),
    "damping by place": ("velocity", "v * np.abs(x)"),
    "dry friction": ("direction", "s"),
    "friction by place": ("direction", "s * np.abs(x)"),
    "friction by load": ("direction", "s * np.abs(e)"),
    "a mass that is not constant": ("acceleration", "np.abs(a)"),
    "creep": ("past motion", "fades(x, t, run, 0.1)"),
    "slow creep": ("past motion", "fades(x, t, run, 1.0)"),
    "hysteresis": ("past motion", "way(x, run, 0.04)"),
    "a late reading": ("effort", "e - late(e, t, run, 3.0)"),
    "a smoothed reading": ("effort", "e - low_pass(e, t, run, 0.1)"),
    "a gain": ("effort", "e"),
    "saturation": ("effort", "np.clip(e, -1.0, 1.0)"),
    "its cube": ("effort", "e**3"),
    "friction by a load that is known": ("load", "s * load"),
    "a kink of the load": ("load", "np.abs(load - 2.0)"),
    "warmth": ("temperature", "temperature**2"),
    "damping by warmth": ("temperature", "v * (temperature - temperature.mean())"),
    "stiffness by warmth": ("temperature", "x * (temperature - temperature.mean())"),
    "a gain by a clock of one's own": ("recorded time", "e * (time - time.mean())"),
}  # fmt: skip


def left(columns, law):
    """Share of a law's energy about its mean that the columns do not draw."""
    columns = np.column_stack([np.ones(len(law)), columns])
    return np.var(law - columns @ np.linalg.lstsq(columns, law, rcond=None)[0]) / max(np.var(law), 1e-12)


@pytest.fixture(scope="module")
def swung():
    frame, own = signals(SWUNG)
    return own, features(frame, own["e"])


@pytest.mark.parametrize("name", LAWS)
def test_a_law_of_a_signal_is_drawn_by_its_columns(swung, name):
    own, columns = swung
    signal, law = LAWS[name]
    law = eval(law, {**globals(), **own})
    assert left(columns[signal], law) < 0.02
    assert all(np.isfinite(one).all() and len(one) == len(law) for one in columns.values())
    if signal in {"recorded time", "load", "temperature", "acceleration"}:
        assert left(columns["velocity"], law) > 0.1


PRESS_LAWS = {
    "creep": ("past motion", "low_pass(np.maximum(x, 0), t, run, 0.3, from_rest=True) * (x > 0)"),
    "a film that sticks": ("past motion", "np.exp(x / (0.06 * x.max())) * touched * (x <= 0)"),
    "a spring": ("position", "np.maximum(x, 0)"),
    "a layer": ("position", "np.maximum(x - 0.006, 0)"),
    "what was pressed flat": ("position", "furthest"),
    "damping": ("velocity", "v * (x > 0)"),
}


@pytest.mark.parametrize("name", PRESS_LAWS)
def test_a_law_of_a_contact_is_drawn_where_it_was_touched(name):
    frame, own = signals(PRESSED)
    columns = features(frame, own["e"])
    own["furthest"] = np.concatenate([np.maximum.accumulate(own["x"][own["run"] == r]) for r in range(6)])
    own["touched"] = own["furthest"] > 0
    signal, law = PRESS_LAWS[name]
    law = eval(law, {**globals(), **own})
    assert left(columns[signal], law) < 0.02
    before = (own["furthest"] < -1e-4) & (own["x"] < -1e-4)
    assert not columns["past motion"][before].any()  # nothing is remembered of free air
    assert not columns["velocity"][before].any() or "velocity" not in name


@pytest.mark.parametrize("low", [-1.0, 0.5])
def test_bumps_make_up_any_kinked_line_but_no_constant_of_their_own(low):
    values = np.sort(np.random.default_rng(1).uniform(low, 2.0, 400))
    hats = _hats(values)
    assert (hats >= 0.0).all()
    assert hats.sum(axis=1).max() == pytest.approx(1.0)
    nearest = np.argmin(np.abs(values))
    assert hats[nearest].sum() < 0.1  # of the knot at zero, or nearest to it, none is left
    assert 10 < hats.shape[1] < 22
    assert _hats(np.full(10, low)).shape == (10, 1)
    crowded = np.append(np.zeros(900), np.linspace(0.0, 1.0, 100))
    assert np.linalg.cond(np.column_stack([np.ones(1000), _hats(crowded)])) < 1e4


HIDDEN = {
    "velocity": (lambda q, v, a: 0.2 * np.sin(3.0 * v), {"velocity"}),
    "position": (lambda q, v, a: 0.2 * np.sin(9.0 * q), {"position"}),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_what_a_model_leaves_is_explained_by_the_signal_that_it_depends_on(name):
    law, _own = HIDDEN[name]
    one = fit(swings(6, law, rate_hz=100.0), SWING, {})
    found = flexible(one.plain, one.trial)
    assert max(found.by_signal, key=found.by_signal.get) == name
    assert found.by_signal[name] > 0.8 > 0.3 > found.by_signal["offset"]
    count = one.plain.kept.sum()
    assert NOISE_NM < np.sqrt(found.held_out.sum() / count) < 0.1  # of 0.14 and the noise
    kept = one.plain.kept
    assert np.sum(found.residual[kept] ** 2) == pytest.approx(found.held_out.sum(), rel=0.01)
    others = flexible(one.plain, one.trial, without=[name])
    assert name not in others.by_signal
    assert others.held_out.sum() > 1.3 * found.held_out.sum()
    assert set(signals_of(one.plain, one.trial)) == set(found.by_signal)


def test_of_noise_next_to_nothing_is_explained_and_never_more_than_there_is():
    for data, model in (
        (swings(3, rate_hz=100.0), SWING),
        (session(3), Model("m", (EFFECTS["stiffness"](), EFFECTS["damping"]()))),
    ):
        one = fit(data, model, {})
        found = flexible(one.plain, one.trial)
        assert 0.97 * one.trial.held_out < found.held_out.sum() <= (1.0 + 1e-9) * one.trial.held_out
        assert all(share < 0.02 for share in found.by_signal.values())
    exact = session(3, lambda t, x, v, run: kelvin_voigt(x, v))
    exact = replace(exact, effort=np.zeros(len(exact)))
    one = fit(exact, Model("m", (EFFECTS["stiffness"](),)), {})
    assert set(flexible(one.plain, one.trial).by_signal.values()) == {0.0}
