"""What is named when something is left that nobody has named."""

import numpy as np
import pytest
from estimation.diagnosis.search.chain import build
from estimation.diagnosis.search.dominant import own_signals
from estimation.diagnosis.search.library import library
from estimation.diagnosis.search.search import Search

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS
from estimation.signals.runwise import low_pass
from tests.estimation.presses import kelvin_voigt, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def search(data, without=()):
    effects = tuple(effect for effect in library() if effect.name not in without)
    good = np.ones(len(data), dtype=np.bool_)
    return Search(data, MODEL, good, effects, np.random.default_rng(1), lambda what, share: None)


def answer(data, without=()):
    effects = [effect for effect in library() if effect.name not in without]
    return diagnose(data, MODEL, effects, rng=np.random.default_rng(1)).channels[0]


def stiffening(x):
    return 1.5e6 * np.maximum(x, 0) ** 3


def humming(x, v):
    """A small wave over the speed, which no effect of the library has."""
    return 0.1 * np.sin(150.0 * v) * (x > 0)


def test_what_dominates_is_named_beside_a_rest_that_nobody_knows():
    found = answer(session(21, lambda t, x, v, run: kelvin_voigt(x, v, stiffening(x) + humming(x, v))))
    assert found.verdict is Verdict.UNEXPLAINED
    assert [entry.effect for entry in found.accepted] == ["cubic_stiffness"]
    k3 = found.accepted[0].parameters["k3"]
    assert k3.value == pytest.approx(1.5e6, rel=0.05)
    assert found.final.rmse < 0.3 * found.baseline.rmse
    assert found.final.rmse > found.noise_floor
    assert "cubic_stiffness" not in [suspect.effect for suspect in found.suspects]


def test_an_imitation_gets_no_name_though_it_takes_away_nearly_all():
    data = session(22, lambda t, x, v, run: kelvin_voigt(x, v, stiffening(x)))
    found = answer(data, without=("cubic_stiffness",))
    best = found.ranking[0]
    assert best.score > 0.6
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []


def test_an_effect_is_a_function_of_its_own_signals():
    one = search(session(23, lambda t, x, v, run: kelvin_voigt(x, v, stiffening(x))))
    before = one.start
    after = one.stand(MODEL.with_effect(EFFECTS["cubic_stiffness"]()), {})
    assert "position" in own_signals(before, after)
    assert not {"time", "velocity"} & set(own_signals(before, after))


def test_every_step_of_a_chain_was_weighed():
    chain = build(search(session(24, lambda t, x, v, run: kelvin_voigt(x, v, stiffening(x)) + 0.8)))
    assert {step.effect for step in chain.steps} == {"cubic_stiffness", "bias"}
    for step in chain.steps:
        assert step.evidence.enough
        assert 1 / 200 <= step.evidence.p_value <= 0.01
        assert 0.0 < step.evidence.broad_gain <= 1.0
    errors = [chain.start.rmse, *(step.standing.rmse for step in chain.steps)]
    assert errors == sorted(errors, reverse=True)


def test_a_surface_that_lies_deeper_is_no_dent_though_one_draws_it_in_all_runs_but_the_first():
    data = session(57, lambda t, x, v, run: kelvin_voigt(x - 0.0006, v))
    found = diagnose(data, MODEL, [EFFECTS["plastic_set"]()], rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    # no single signal tells what the dent would leave, but what the model leaves without it
    assert {"position", "effort"} & set(found.depends_on)


def test_a_sensor_that_follows_slowly_is_no_relaxation_that_pushes_back():
    # a spring and a damper seen late are a spring beside a negative spring that relaxes, while they press
    data = session(55, lambda t, x, v, run: low_pass(kelvin_voigt(x, v), t, run, 0.028))
    tried = [EFFECTS[name]() for name in ("stress_relaxation", "delay")]
    found = diagnose(data, MODEL, tried, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert "past motion" in found.depends_on
