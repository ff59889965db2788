"""Experiment design for discrimination, against refitted rivals and known cases."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.design.discrimination import (
    Experiment,
    RivalModels,
    choose_experiment,
    separated_names,
)
from palpate.estimation.design.next_experiment import _candidate_motions, extent
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.models import MODELS
from tests.estimation.contact_data import channel
from tests.estimation.study.joints import joints

K, C = 500.0, 20.0


def pressed(depth_m, speeds, runs=4, seed=0, force=None):
    """Presses down to a depth at several angular speeds; the force of a law, with 0.02 N of noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 1.0, 0.005)
    x = np.concatenate([depth_m * (1 - np.cos(w * t)) / 2 - 0.001 for w in np.resize(speeds, runs)])
    v = np.concatenate([depth_m * w * np.sin(w * t) / 2 for w in np.resize(speeds, runs)])
    law = force or (lambda x, v: K * x + C * v)
    push = np.where(x > 0.0, law(x, v), 0.0).clip(0.0) + rng.normal(0.0, 0.02, len(x))
    return channel(push, x, v, np.tile(t, runs), run=np.repeat(np.arange(runs), len(t)))


def rivals(data, *names):
    base = MODELS["kelvin_voigt"]().build(ModelContext())
    starts = {"exponential_stiffness.depth": 0.02}
    return RivalModels.of([fit_model(data, base.with_effect(EFFECTS[name]()), starts) for name in names])


@pytest.fixture(scope="module")
def shallow():
    """A stiffening that shows as a square and as a cube alike, as long as nobody presses deeper."""
    data = pressed(0.006, [6.0, 9.0], force=lambda x, v: K * x + C * v + 2e6 * x**3)
    return rivals(data, "cubic_stiffness", "exponential_stiffness")


def test_extent_of_a_pulled_element_is_its_range_of_motion():
    data = pressed(0.006, [6.0])
    assert extent(data).startswith("to a displacement of 5 mm, at up to 18 mm/s")
    pulled = replace(data, touching=np.ones(len(data), bool))
    assert extent(pulled).startswith("over 6 mm")


def test_deeper_press_separates_two_stiffenings_and_the_same_press_does_not(shallow):
    again, deeper = pressed(0.006, [6.0, 9.0], seed=1), pressed(0.018, [6.0, 9.0], seed=1)
    for leads in (shallow.predicted_leads, lambda m: shallow.simulated_leads(m, np.random.default_rng(0))):
        assert leads(deeper)[0, 1] > 0.2
        assert np.abs(leads(again)).max() < 0.05


def test_first_order_prediction_equals_refitting_for_linear_models():
    data = pressed(0.006, [6.0], force=lambda x, v: K * x + C * v + 2e6 * x**3)
    linear = rivals(data, "cubic_stiffness", "quadratic_damping")
    for depth in (0.006, 0.012, 0.018):
        motion = pressed(depth, [3.0, 12.0], seed=2)
        promised, expected = (
            linear.predicted_leads(motion),
            linear.simulated_leads(motion, np.random.default_rng(0)),
        )
        assert promised == pytest.approx(expected, abs=0.06)


def test_data_from_the_true_law_confirm_the_expected_evidence(shallow):
    """Not drawn by the code: the lead is what two fits to new data really show."""
    motion = pressed(0.018, [6.0, 9.0], seed=3)
    law = pressed(0.018, [6.0, 9.0], seed=4, force=lambda x, v: K * x + C * v + 2e6 * x**3)
    old = pressed(0.006, [6.0, 9.0], force=lambda x, v: K * x + C * v + 2e6 * x**3)
    both = pressed(0.006, [6.0, 9.0], runs=8)
    merged = {
        n: np.concatenate([getattr(old, n), getattr(law, n)]) for n in ("position", "velocity", "effort")
    }
    whole = channel(merged["effort"], merged["position"], merged["velocity"], both.time_s, run=both.run)
    base = MODELS["kelvin_voigt"]().build(ModelContext())
    left = [
        fit_model(
            whole, base.with_effect(EFFECTS[n]()), {"exponential_stiffness.depth": 0.02}
        ).solution.held_out
        for n in ("cubic_stiffness", "exponential_stiffness")
    ]
    really = 1.0 - np.sqrt(left[0] / left[1])
    assert shallow.simulated_leads(motion, np.random.default_rng(0))[0, 1] == pytest.approx(really, abs=0.1)


def test_shortest_of_the_most_informative_experiments_is_chosen():
    def lead(value):
        return (np.array([[0.0, value], [value, 0.0]]),)

    long, short, weak = (
        Experiment(w, s, lead(v)) for w, s, v in (("l", 60, 0.9), ("s", 5, 0.2), ("w", 1, 0.1))
    )
    assert choose_experiment([long, short, weak]).experiment is short
    assert "Of 2 nearly equally" in choose_experiment([long, short, weak]).reason
    assert "experiments, this is the shortest." in choose_experiment([long, short, weak]).reason
    assert "most informative" in choose_experiment([short, weak]).reason
    known = [replace(long, evidence=2.0), replace(short, evidence=1.0)]
    assert "2 nearly equally informative experiments, this promises" in choose_experiment(known).reason
    assert choose_experiment([weak, Experiment("weaker", 1, lead(0.06))]).experiment is weak
    assert choose_experiment([Experiment("nothing", 1, lead(0.02))]) is None
    assert choose_experiment([]) is None


def test_experiment_that_separates_most_pairs_is_preferred():
    """After the first, one of two rivals that it does not tell apart is left in two cases of three."""
    far, all_apart = np.zeros((3, 3)), np.full((3, 3), 0.2)
    far[0, 1:] = far[1:, 0] = 0.9
    offered = [Experiment("far", 1, (far,)), Experiment("all", 20, (all_apart,))]
    assert choose_experiment(offered).index == 1
    one_pair = np.zeros((3, 3))
    one_pair[0, 2] = one_pair[2, 0] = 0.3
    offered = [Experiment("none", 1, (np.full((3, 3), 0.01),)), Experiment("one", 1, (one_pair,))]
    assert choose_experiment(offered).index == 1


def test_only_rivals_that_an_experiment_separates_are_named():
    lead = np.zeros((3, 3))
    assert separated_names(["a", "b", "c"], lead) == []
    lead[2, 0] = 0.2  # if c is true, a is rejected
    assert separated_names(["a", "b", "c"], lead) == ["a", "c"]


def test_recorded_motion_is_offered_faster_slower_and_further(shallow):
    data = shallow.data
    faster, slower, further, nearer = (moved for _, _, moved in _candidate_motions(data))
    for moved, speed in ((faster, 3.0), (slower, 1.0 / 3.0)):
        derived = np.gradient(moved.position[:200], moved.time_s[:200])
        assert moved.velocity[5:190] == pytest.approx(derived[5:190], abs=1e-3 * speed)
    assert further.position.max() > 1.4 * data.position.max() > 2.0 * nearer.position.max()
    assert "mm/s" in next(iter(_candidate_motions(data)))[0]


def test_evidence_of_two_experiments_adds_up():
    def experiment(lead):
        return Experiment("e", 1.0, (np.array([[0.0, lead], [0.0, 0.0]]),))

    both = experiment(0.1).combined_with(experiment(0.1))
    assert both.leads[0] == pytest.approx(np.array([[0.0, 1.0 - (2.0 / 0.9**2 - 1.0) ** -0.5], [0.0, 0.0]]))
    assert both.duration_s == 2.0


def test_effect_with_joint_load_is_refitted_from_its_starts():
    (joint, _), (planned, _) = joints(), joints(seed=1)
    base = MODELS["inertia"]().build(ModelContext())
    starts = {"joint_elasticity.compliance": 1e-3}
    names = ("joint_elasticity", "coulomb_friction")
    fits = [fit_model(joint, base.with_effect(EFFECTS[name]()), starts) for name in names]
    assert np.isfinite(RivalModels.of(fits).simulated_leads(planned, np.random.default_rng(0))).all()
