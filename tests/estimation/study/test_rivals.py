"""Indistinguishable laws: remaining questions, and which law is stated."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.control.loop.task import Phase
from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.result import AcceptedEffect
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.other_models import keep_simplest_rivals, rival_effects
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


def _diagnosis_of(*groups):
    told = {"parameters": {}, "rmse_before": 0.05, "rmse_after": 0.01, "p_value": 0.001}
    told |= dict.fromkeys(("physics", "equation", "signature"), "")
    accepted = [AcceptedEffect(effect=named, confused_with=others, **told) for named, others in groups]
    about = {"channel": "joint_1", "verdict": "missing", "reason": "why", "effort_unit": "N m"}
    return ChannelDiagnosis(complete=True, accepted=accepted, **about)
