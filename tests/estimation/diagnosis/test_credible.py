"""What explains all and is still not what its name says gets no name."""

import numpy as np
import pytest
from estimation.diagnosis.search.credible import is_credible
from estimation.diagnosis.search.library import library
from estimation.diagnosis.search.search import Search

from estimation.base_model import ModelContext
from estimation.channel import ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS
from tests.estimation.diagnosis.test_pairs_in_a_joint import NOISE_NM, channel, pendulum
from tests.estimation.presses import K, kelvin_voigt, session

BASE = {ChannelKind.CONTACT: "kelvin_voigt", ChannelKind.REVOLUTE: "pendulum"}


def search(data):
    model = MODELS[BASE[data.kind]]().build(ModelContext())
    good = np.ones(len(data), dtype=np.bool_)
    return Search(data, model, good, library(), np.random.default_rng(1), lambda what, share: None)


def fitted(tried, *names, **inner):
    model = tried.model
    for name in names:
        model = model.with_effect(EFFECTS[name]())
    return tried.stand(model, {key.replace("__", "."): value for key, value in inner.items()})


def answer(data, *names):
    model = MODELS[BASE[data.kind]]().build(ModelContext())
    effects = [EFFECTS[name]() for name in names]
    return diagnose(data, model, effects, rng=np.random.default_rng(1)).channels[0]


def cut(t, x, v, run):
    return np.minimum(kelvin_voigt(x, v), 6.0)


def layered(t, x, v, run):
    return kelvin_voigt(x, v, 600.0 * np.maximum(x - 0.005, 0.0))


@pytest.mark.parametrize(("law", "credible"), [(cut, False), (layered, True)])
def test_a_layer_without_resistance_is_not_believed(law, credible):
    tried = search(session(51, law))
    end = fitted(tried, "layered_stiffness", layered_stiffness__depth=0.006)
    assert end.rmse < 0.3 * tried.start.rmse
    assert is_credible(tried.start, end) is credible


def test_a_constant_drawn_by_three_effects_is_not_believed():
    tried = search(session(52, lambda t, x, v, run: kelvin_voigt(x, v) + 0.8))
    size = {"hysteresis__width": 0.8, "dry_friction__presliding": 1e-6, "contact_offset__offset": -0.8 / K}
    end = fitted(tried, "hysteresis", "dry_friction", "contact_offset", **size)
    assert end.rmse < 0.2 * tried.start.rmse
    assert not is_credible(tried.start, end)
    assert is_credible(tried.start, fitted(tried, "bias"))


def test_coulomb_friction_is_no_stribeck_friction_where_only_that_is_known():
    q, v, a, effort, rng = pendulum(6, lambda q, v: 0.3 * np.clip(v / 0.01, -1.0, 1.0))
    joint = channel(q, v, a, effort + rng.normal(0.0, NOISE_NM, effort.shape))
    found = answer(joint, "stribeck_friction", "bias")
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert "stribeck_friction" in [suspect.effect for suspect in found.suspects]
    assert "direction" in found.depends_on
    assert [entry.effect for entry in answer(joint, "stribeck_friction", "coulomb_friction").accepted] == [
        "coulomb_friction"
    ]


@pytest.mark.parametrize(("damping", "credible"), [(15.0, True), (-0.1, True), (-15.0, False)])
def test_a_base_model_whose_damper_pushes_is_not_believed(damping, credible):
    tried = search(
        session(53, lambda t, x, v, run: np.where(x > 0, np.maximum(K * x + damping * v, 0.0), 0.0))
    )
    assert tried.leaves_noise(tried.start)
    assert is_credible(tried.start, tried.start) is credible
