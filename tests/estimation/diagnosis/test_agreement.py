"""Runs that do not follow one law: nothing in the data says why, and no effect may be named for it."""

import numpy as np
import pytest
from estimation.diagnosis.judgement.agreement import disagreement

from estimation.diagnosis import Verdict, diagnose
from estimation.fit.standing import stand
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.presses import NOISE_N, kelvin_voigt, session

CHANGES = {
    "a sensor of another scale": lambda force, run: np.where(run == 2, 1.2 * force, force),
    "another specimen": lambda force, run: np.where(run >= 3, 3.0 * force, force),
    "another zero": lambda force, run: force + 0.5 * (run % 2),
    "a dead sensor": lambda force, run: np.where(run == 4, 0.0, force),
}


@pytest.mark.parametrize("change", CHANGES)
def test_runs_that_differ_are_told_and_no_effect_is_blamed(change):
    data = session(5, lambda t, x, v, run: CHANGES[change](kelvin_voigt(x, v), run))
    found = diagnose(data, MODEL, rng=np.random.default_rng(0)).channels[0]
    assert found.verdict is Verdict.UNEXPLAINED
    assert "do not follow one law" in found.reason
    assert found.accepted == []
    assert found.depends_on == ["run"]
    assert found.noise_floor < 0.5 * found.baseline.rmse
    assert found.next_experiment.probe["repeats"] > 3


@pytest.mark.parametrize(("change", "odd"), [("a sensor of another scale", 2), ("a dead sensor", 4)])
def test_the_odd_one_out_is_named(change, odd):
    data = session(6, lambda t, x, v, run: CHANGES[change](kelvin_voigt(x, v), run))
    found = disagreement(stand(data, MODEL, {}))
    assert found.run == odd
    assert found.run_alone < 1.2 * NOISE_N < found.run_predicted


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.97])
def test_slow_noise_is_no_disagreement(correlation):
    for seed in range(5):
        assert disagreement(stand(session(seed, correlation=correlation), MODEL, {})) is None


def test_a_short_run_does_not_excuse_the_others():
    data = session(7, lambda t, x, v, run: CHANGES["another zero"](kelvin_voigt(x, v), run))
    short = data.select((data.run != data.runs[-1]) | (np.cumsum(data.run == data.runs[-1]) <= 60))
    found = disagreement(stand(short, MODEL, {}))
    assert found is not None
    assert found.alone < 1.2 * NOISE_N < found.predicted


def test_a_surface_that_sinks_from_run_to_run_is_no_relaxation():
    # what is remembered for ever, at the end of what can be remembered, is another surface in each run
    data = session(12, lambda t, x, v, run: kelvin_voigt(x - 0.0003 * run, v))
    found = diagnose(data, MODEL, rng=np.random.default_rng(0)).channels[0]
    assert "stress_relaxation" not in [entry.effect for entry in found.accepted]
