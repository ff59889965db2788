"""Indistinguishable laws: remaining questions, and which law is stated."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.control.loop.task import Phase
from palpate.estimation.design.next_experiment import (
    NO_PROBE,
    NO_VARIED_MOTION,
    NextExperiment,
    propose_known_experiment,
    propose_varied_motion,
)
from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.result import AcceptedEffect
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.other_models import keep_simplest_rivals, rival_effects
from tests.estimation.presses import kelvin_voigt, session
from tests.estimation.study.joints import joints


@pytest.fixture(scope="module")
def study():
    """Of an arm: what friction does while a joint turns round is not judged."""
    rubbing, _ = joints(friction_nm=(0.05, 0.0))
    return ModelStudy((replace(rubbing, phase=np.full(len(rubbing), Phase.MOVE)),), "inertia")


@pytest.mark.parametrize(
    ("named", "others", "kept"),
    [
        ("coulomb_friction", ["presliding_friction"], []),  # as many parameters, and it depends on less
        ("presliding_friction", ["coulomb_friction"], []),
        ("bouc_wen_hysteresis", ["presliding_friction", "coulomb_friction"], []),
        ("coulomb_friction", ["joint_spring"], ["joint_spring"]),  # another function
    ],
)
def test_simplest_nested_law_is_stated(study, named, others, kept):
    found = keep_simplest_rivals(study, study.channel("joint_1"), _diagnosis_of((named, others)))
    assert [(one.effect, one.confused_with) for one in found.accepted] == [("coulomb_friction", kept)]


def test_rival_of_another_kind_is_no_simpler_law(study):
    """Bouc-Wen's law can follow a spring, but a spring is another explanation of the error."""
    named = ("bouc_wen_hysteresis", ["joint_spring", "payload"])  # a payload does not apply to this model
    found = keep_simplest_rivals(study, study.channel("joint_1"), _diagnosis_of(named))
    assert [(one.effect, one.confused_with) for one in found.accepted] == [named]


def test_rivals_are_compared_wherever_they_stand_in_their_models(study, monkeypatch):
    """A fit that tries other forms of an earlier effect puts that effect behind the last one."""
    fitted = study.fit

    def fit_turned(channel, effects=()):
        fit = fitted(channel, effects)
        turned = replace(fit.model, effects=fit.model.effects[::-1])
        return fit_model(fit.training, turned, fit.values)

    monkeypatch.setattr(study, "fit", fit_turned)
    friction = "presliding_friction", ["coulomb_friction"]
    found = keep_simplest_rivals(study, study.channel("joint_1"), _diagnosis_of(("lag", []), friction))
    assert [(one.effect, one.confused_with) for one in found.accepted] == [
        ("lag", []),
        ("coulomb_friction", []),
    ]


TWO_GROUPS = (
    ("coulomb_friction", ["presliding_friction", "asymmetric_friction"]),
    ("bias", ["payload", "asymmetric_friction"]),
)


def test_each_group_is_separate_and_a_whole_stands_for_its_parts():
    friction, constant = rival_effects(_diagnosis_of(*TWO_GROUPS), effect_library())
    beside_bias = [["bias", "coulomb_friction"], ["bias", "presliding_friction"]]
    assert friction == [*beside_bias, ["asymmetric_friction"]]
    beside_friction = [["coulomb_friction", name] for name in ("bias", "payload")]
    assert constant == [*beside_friction, ["asymmetric_friction"]]


def test_simplest_effect_of_each_group_is_stated(study):
    """Friction that differs between directions is plain friction and a bias: neither name says less."""
    data = study.channel("joint_1").data
    pulled = ModelStudy((replace(data, effort=data.effort + 0.03),), "inertia")
    groups = (TWO_GROUPS[0], ("bias", ["asymmetric_friction"]))
    found = keep_simplest_rivals(pulled, pulled.channel("joint_1"), _diagnosis_of(*groups))
    assert [(one.effect, one.confused_with) for one in found.accepted] == [
        ("coulomb_friction", ["asymmetric_friction"]),
        ("bias", ["asymmetric_friction"]),
    ]


def test_law_that_contains_the_stated_one_is_no_reason_for_an_experiment():
    """A power law beside a spring, with the exponent 3, is a cubic spring."""
    data = session(4, lambda t, x, v, run: kelvin_voigt(x, v) + 3e6 * x**3)
    pressed = ModelStudy((data,), "kelvin_voigt")
    channel, names = pressed.channel("contact"), ["cubic_stiffness", "power_law_stiffness"]
    fits = {name: pressed.fit(channel, [name]).training_fit for name in names}
    assert propose_varied_motion(fits, channel.data) is None
    following = propose_known_experiment(EFFECTS[names[0]](), names, channel.data)
    changed = {"channel": "contact", "next_experiment": following, "no_experiment": NO_VARIED_MOTION}
    entry = _diagnosis_of((names[0], names[1:])).model_copy(update=changed)
    (found,) = pressed.settle([entry], None)
    assert [(one.effect, one.confused_with) for one in found.accepted] == [("cubic_stiffness", [])]
    assert found.next_experiment is None
    assert "laws that contain a simpler law are left out (power_law_stiffness)" in found.no_experiment


def test_law_that_contains_the_stated_one_is_dropped_beside_an_experiment_for_another():
    data = session(4, lambda t, x, v, run: kelvin_voigt(x, v) + 3e6 * x**3)
    pressed = ModelStudy((data,), "kelvin_voigt")
    names = ["cubic_stiffness", "power_law_stiffness", "exponential_stiffness"]
    channel = pressed.channel("contact")
    fits = {name: pressed.fit(channel, [name]).training_fit for name in names}
    varied = propose_varied_motion(fits, channel.data)
    assert varied.separates == ["cubic_stiffness", "exponential_stiffness"]
    changed = {"channel": "contact", "next_experiment": varied}
    entry = _diagnosis_of((names[0], names[1:])).model_copy(update=changed)
    (found,) = pressed.settle([entry], None)
    assert [(one.effect, one.confused_with) for one in found.accepted] == [(names[0], names[2:])]
    assert found.next_experiment == varied
    assert "left out (power_law_stiffness)" in found.no_experiment
    assert found.no_experiment.endswith("no change of the recorded motion is expected to separate the two")


@pytest.mark.parametrize("is_arm", [True, False])
def test_arm_proposes_no_experiment_that_it_found_useless(study, monkeypatch, is_arm):
    """A recording keeps the experiment that the library states, which is no change of its motion."""
    monkeypatch.setattr(study, "_can_plan", lambda: is_arm)
    varied = NextExperiment(purpose="p", separates=[], instruction="three times as fast", probe={})
    changed = {"next_experiment": varied, "no_experiment": NO_VARIED_MOTION}
    entry = _diagnosis_of(("coulomb_friction", ["joint_spring"])).model_copy(update=changed)
    (settled,) = study.settle([entry], None)
    assert (settled.next_experiment is None) == is_arm
    assert settled.no_experiment == (NO_PROBE if is_arm else NO_VARIED_MOTION)


def _diagnosis_of(*groups):
    told = {"parameters": {}, "rmse_before": 0.05, "rmse_after": 0.01, "p_value": 0.001}
    told |= dict.fromkeys(("physics", "equation", "signature"), "")
    accepted = [AcceptedEffect(effect=named, confused_with=others, **told) for named, others in groups]
    about = {"channel": "joint_1", "verdict": "missing", "reason": "why", "effort_unit": "N m"}
    return ChannelDiagnosis(complete=True, accepted=accepted, **about)
