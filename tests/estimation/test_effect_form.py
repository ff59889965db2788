"""One form for all registered effects."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.diagnosis import diagnose
from palpate.estimation.effect import (
    SIGNALS,
    AdditiveEffect,
    Effect,
    MemoryEffect,
    MotionEffect,
    SensorEffect,
)
from palpate.estimation.effects import EFFECTS
from palpate.estimation.kinds import Kind
from palpate.estimation.model import Model
from tests.estimation.swings import read, swings
from tests.few_effects import shorten_budget

EVERY = pytest.mark.parametrize("name", list(EFFECTS))


def some_channel(kind):
    """A second of motion in two runs, with every signal that an effect may ask for."""
    t = np.tile(np.arange(500) * 1e-3, 2)
    x, v = 0.01 * np.sin(6 * t) ** 2 + 1e-3 * t, 0.06 * np.sin(12 * t)
    run = np.repeat([0, 1], 500)
    base = ChannelData("c", kind, t, x, v, np.gradient(v, 1e-3), 5 + x, run, np.full(1000, -1))
    signals = {need: 1.0 + 0.5 * np.cos(3 * t) for effect in EFFECTS.values() for need in effect.needs}
    wide = {
        n: 30 if n.endswith("regressor") else 6 for n in signals if n.startswith(("joint_", "rigid_body_reg"))
    }
    signals = {n: np.outer(v, np.ones(wide[n])) if n in wide else v for n, v in signals.items()}
    return ChannelData(**{**vars(base), "context": signals})


def inner_values(effect):
    return {p.name: float(p.spread(3)[1]) for p in effect.inner}


@EVERY
def test_effect_has_physics_signals_kind_and_parameters_with_units_and_bounds(name):
    effect = EFFECTS[name]
    assert issubclass(effect, AdditiveEffect | MotionEffect | MemoryEffect | SensorEffect)
    assert effect.name == name == name.lower()
    for text in (effect.physics, effect.equation, effect.source, effect.signature):
        assert len(text.strip()) >= 5
    assert effect.physics.endswith(".")
    assert effect.channels
    assert effect.channels <= frozenset(ChannelKind)
    assert effect.signals != SIGNALS
    assert set(effect.signals) <= set(SIGNALS)
    assert len(set(effect.signals)) == len(effect.signals)
    assert effect().kind in Kind
    assert effect().also <= frozenset(Kind) - {effect().kind}
    for other, experiment in effect.confused_with.items():
        assert other in EFFECTS, f"{name} is confused with '{other}', which is no effect"
        assert other != name
        assert len(experiment) > 10
    parameters = effect.gains + effect.inner
    assert parameters or effect.needs  # without any, it must bring a signal
    assert len({p.name for p in parameters}) == len(parameters)
    assert not effect.path or {p.name: p.unit for p in effect.inner}[effect.path] == "{position}"
    for p in parameters:
        assert p.unit.format(effort="N", position="m", inertia="kg")
        assert p.lower <= p.typical[0] < p.typical[1] <= p.upper
        assert not p.log or p.typical[0] > 0
        assert all(map(math.isfinite, p.typical))


@EVERY
def test_effect_keeps_its_form_on_data_and_starts_within_the_bounds(name):
    effect: Effect = EFFECTS[name]()
    inner, bounds = inner_values(effect), {p.name: p for p in effect.inner}
    for kind in effect.channels:
        data = some_channel(kind)
        both = np.column_stack([data.effort, data.position])
        if isinstance(effect, AdditiveEffect):
            columns = effect.columns(data, inner)
            assert columns.shape == (len(data), len(effect.gains))
            assert np.isfinite(columns).all()
            assert effect.known(data, inner).shape == (len(data),)
        elif isinstance(effect, MotionEffect):
            assert len(effect.move(data, inner)) == len(data)
        elif isinstance(effect, MemoryEffect):
            assert np.isfinite(effect.fade(both, data, inner)).all()
            assert effect.fade(both, data, inner).shape == (len(data), 2)
        elif isinstance(effect, SensorEffect):
            assert effect.sense(data.effort, data, inner).shape == (len(data),)
            assert effect.sense(both, data, inner).shape == (len(data), 2)
        starts = effect.starts(data)
        assert starts
        for start in starts:
            assert set(start) == set(bounds)
            assert all(bounds[n].lower <= value <= bounds[n].upper for n, value in start.items())


@pytest.mark.parametrize("name", [name for name, e in EFFECTS.items() if issubclass(e, SensorEffect)])
def test_slopes_and_reading_at_once_match_those_of_each(name):
    effect = EFFECTS[name]()
    data, inner = some_channel(next(iter(effect.channels))), inner_values(effect)
    columns = np.column_stack([data.position, data.velocity])
    slopes, reading = effect.follow(data.effort, columns, data, inner)
    np.testing.assert_allclose(slopes, effect.slope(data.effort, columns, data, inner), rtol=1e-12)
    initial = effect.initial_response(data, inner)
    expected = effect.sense(data.effort, data, inner) + (0.0 if initial is None else initial)
    np.testing.assert_allclose(reading, expected, rtol=1e-12)


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if getattr(e, "pointwise", False)])
def test_pointwise_sensor_shows_the_mean_of_its_readings(name):
    effect = EFFECTS[name]()
    data, inner = some_channel(next(iter(effect.channels))), inner_values(effect)
    of_samples = effect.sense(data.effort, data, inner).reshape(-1, 10).mean(axis=1)
    of_means = effect.sense(data.effort.reshape(-1, 10).mean(axis=1), data, inner)
    np.testing.assert_allclose(of_means, of_samples, rtol=1e-12)


@pytest.mark.parametrize("noise", [0.01, 0.1, 0.2, 0.4])
def test_coarse_steps_are_smoothed_by_noise_on_average(noise):
    effect, step = EFFECTS["quantisation"](), 0.5
    effort = np.linspace(-1.3, 1.3, 53)
    each = noise * step * ndtri((np.arange(20_000) + 0.5) / 20_000)  # equally likely
    shown = (step * np.round((effort[:, None] + each) / step)).mean(axis=1)
    found = effect.sense(effort, some_channel(ChannelKind.CONTACT), {"step": step, "noise": noise * step})
    np.testing.assert_allclose(found, shown, atol=1e-4 * step)


@pytest.mark.parametrize("name", ["presliding_friction", "bouc_wen_hysteresis", "dry_friction"])
def test_characteristic_path_is_at_least_half_an_encoder_step(name):
    """Dry friction is friction without its path, too."""
    effect, data = EFFECTS[name](), read(swings(1, runs=2), step=1.5e-3)
    suited = effect.suited_to(data)
    (path,) = (parameter for parameter in suited.inner if parameter.name in {"presliding", "path"})
    (own,) = (parameter for parameter in effect.inner if parameter.name == path.name)
    assert path.lower == pytest.approx(0.75e-3 if effect.path else own.lower, rel=0.1)
    assert min(start[path.name] for start in suited.starts(data)) >= path.lower
    assert effect.inner is type(effect).inner
    assert effect.suited_to(data) is suited  # otherwise its columns would be computed again


def test_presliding_shorter_than_an_encoder_step_is_identified(monkeypatch):
    shorten_budget(monkeypatch)
    rng, t = np.random.default_rng(4), 0.01 * np.arange(1200)
    run = np.repeat([0, 1, 2], 400)
    stops = np.repeat(rng.uniform(-0.5, 0.5, 24), 50)  # it moves for a fifth of the time, and rests
    position = np.convolve(np.pad(stops, 5, mode="edge"), np.ones(10) / 10.0, "same")[5:-5]
    held = np.ones(len(t))
    for i in range(1, len(t)):
        moved = position[i] - position[i - 1]
        held[i] = np.sign(moved) if abs(moved) > 1e-9 else held[i - 1]
    made = differentiate(t, 4e-3 * np.round(position / 4e-3), run)
    torque = 0.3 * held + 0.02 * rng.standard_normal(len(t))
    motion = (4e-3 * np.round(position / 4e-3), made.velocity, made.acceleration)
    data = ChannelData("joint_1", ChannelKind.REVOLUTE, t, *motion, torque, run, np.full(len(t), -1))
    loose = Model("inertia", (EFFECTS["inertia"](), EFFECTS["viscous_friction"]()))
    tried = [EFFECTS[name]() for name in ("presliding_friction", "coulomb_friction", "hysteresis")]
    found = diagnose(data, loose, tried, rng=np.random.default_rng(1)).channels[0]
    assert [entry.effect for entry in found.accepted] == ["presliding_friction"]
    assert found.accepted[0].parameters["force"].value == pytest.approx(0.3, rel=0.1)


def test_wider_forms_of_joint_elasticity_smooth_its_load_more():
    data = swings(1, runs=1)
    data = replace(data, context={"load": np.sin(3.0 * data.time_s)})
    forms = EFFECTS["joint_elasticity"]().forms()
    changes = [
        np.std(form.move(data, {"compliance": 1.0}).acceleration - data.acceleration) for form in forms
    ]
    assert len(forms) > 1
    assert np.all(np.diff(changes) < 0.0)
