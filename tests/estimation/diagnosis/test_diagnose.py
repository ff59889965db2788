import json

import numpy as np
import pytest
from estimation.diagnosis.search.library import library

from estimation.base_model import ModelContext
from estimation.data.derivatives import differentiate
from estimation.diagnosis import Verdict, diagnose
from estimation.models import MODELS
from tests.estimation.presses import C, K, channel, kelvin_voigt, maxwell, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def answer(data, without=()):
    effects = [effect for effect in library() if effect.name not in without]
    return diagnose(data, MODEL, effects, rng=np.random.default_rng(1)).channels[0]


def cubic(t, x, v, run):
    return kelvin_voigt(x, v, 1.5e6 * np.maximum(x, 0) ** 3)


def relaxing(t, x, v, run):
    return kelvin_voigt(x, v, 300.0 * maxwell(t, x, run, 0.4))


@pytest.fixture(scope="module")
def stiffening():
    """The diagnosis of a spring that stiffens, and what was told on the way."""
    told, rng = [], np.random.default_rng(1)
    found = diagnose(
        session(4, cubic),
        MODEL,
        rng=rng,
        progress=lambda what, share: told.append((what, share)),
        file="a.csv",
    )
    return found, told


@pytest.mark.parametrize("correlation", [0.0, 0.97])
def test_finds_nothing_where_nothing_is_missing(correlation):
    found = answer(session(3, correlation=correlation))
    assert found.verdict is Verdict.ADEQUATE
    assert found.accepted == []
    assert found.noise_floor == pytest.approx(0.05, rel=0.15)
    assert found.final.rmse == pytest.approx(found.baseline.rmse)


def test_names_a_stiffening_spring_and_its_size(stiffening):
    found = stiffening[0].channels[0]
    assert found.verdict is Verdict.MISSING
    assert [entry.effect for entry in found.accepted] == ["cubic_stiffness"]
    assert found.ranking[0].effect == "cubic_stiffness"
    k3 = found.accepted[0].parameters["k3"]
    assert k3.value == pytest.approx(1.5e6, abs=4 * k3.std_err)
    assert k3.unit == "N/m^3"
    assert found.final.parameters["stiffness.k"].value == pytest.approx(K, rel=0.01)
    assert found.final.rmse == pytest.approx(found.noise_floor, rel=0.05)
    assert found.accepted[0].rmse_after < 0.3 * found.accepted[0].rmse_before


def test_names_two_effects_at_once():
    found = answer(session(5, lambda t, x, v, run: relaxing(t, x, v, run) + 0.8))
    assert {entry.effect for entry in found.accepted} == {"stress_relaxation", "bias"}
    tau = next(e for e in found.accepted if e.effect == "stress_relaxation").parameters["tau"]
    assert tau.value == pytest.approx(0.4, abs=max(4 * tau.std_err, 0.02))


def test_says_unexplained_when_the_library_lacks_the_effect():
    found = answer(session(6, relaxing), without=("stress_relaxation",))
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert "past motion" in found.depends_on
    assert found.next_experiment is not None
    assert found.noise_floor < 0.5 * found.baseline.rmse


def test_an_effect_that_nobody_has_named_gets_no_name():
    found = answer(session(7, lambda t, x, v, run: kelvin_voigt(x, v) + 0.6 * np.sin(900.0 * x) * (x > 0)))
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert {"position", "effort"} & set(found.depends_on)


def test_result_has_the_documented_keys(stiffening):
    found = json.loads(stiffening[0].model_dump_json())
    assert set(found) == {"file", "model", "channels"}
    keys = {"channel", "verdict", "reason", "noise_floor", "baseline", "accepted", "ranking", "final"}
    assert keys | {"depends_on", "next_experiment"} <= set(found["channels"][0])
    entry = found["channels"][0]["accepted"][0]
    assert {"effect", "parameters", "rmse_before", "rmse_after", "p_value", "confused_with"} <= set(entry)
    assert set(entry["parameters"]["k3"]) == {"value", "std_err", "unit"}
    assert set(found["channels"][0]["ranking"][0]) == {"effect", "rmse_held_out", "score"}


def test_the_same_seed_gives_the_same_answer(stiffening):
    assert answer(session(4, cubic)) == stiffening[0].channels[0]


def test_progress_is_told(stiffening):
    told = stiffening[1]
    assert told
    assert all("contact" in what and 0.0 <= share <= 1.0 for what, share in told)


def test_sharp_corners_of_the_motion_are_no_missing_effect():
    # the velocity of a ramp jumps between two samples; what a derivative makes of it is wrong around them
    rng, dt, parts = np.random.default_rng(8), 1.0 / 200.0, []
    for number in range(6):
        speed = (0.1, 0.05, 0.02)[number % 3]
        travel = (0.01 * rng.uniform(0.8, 1.1) + 0.003) / speed
        steps = ((0.3, 0.0), (travel, speed), (0.8, 0.0), (travel, -speed), (0.3, 0.0))
        v = np.concatenate([np.full(round(t / dt), s) for t, s in steps])
        parts.append((10.0 * number + dt * np.arange(len(v)), np.cumsum(v) * dt - 0.003, v))
    time_s, x, v = (np.concatenate(signals) for signals in zip(*parts, strict=True))
    run = np.repeat(np.arange(6), [len(part[0]) for part in parts])
    force = kelvin_voigt(x, v) + rng.normal(0.0, 0.02, len(x))
    derived = differentiate(time_s, x, run).velocity
    found = answer(channel(force, time_s, x, derived, run))
    assert found.verdict is Verdict.ADEQUATE
    assert found.final.parameters["damping.c"].value == pytest.approx(C, rel=0.02)
