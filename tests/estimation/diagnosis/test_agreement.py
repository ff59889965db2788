"""Joints that name different effects of the arm, or state different values of one of its parameters."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.diagnosis import ChannelDiagnosis, diagnose
from palpate.estimation.diagnosis.agreement import replaceable_effects, with_cautions
from palpate.estimation.diagnosis.result import AcceptedEffect, FitSummary, ParameterValue
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.inertia import Inertia
from palpate.estimation.model import Model
from tests.estimation.test_effect_form import some_channel


def diagnosed(joint, parameter, value, std_err, unit, alternatives=(), complete=True):
    values = {parameter: ParameterValue(value=value, std_err=std_err, unit=unit)}
    final, name = FitSummary(rmse=0.1, parameters=values), parameter.partition(".")[0]
    text = dict.fromkeys(("physics", "equation", "signature"), "")
    errors = {"rmse_before": 0.2, "rmse_after": 0.1, "p_value": 0.0}
    named = AcceptedEffect(effect=name, parameters={}, confused_with=[*alternatives], **errors, **text)
    about = {"verdict": "missing", "reason": "r", "effort_unit": "N m", "complete": complete}
    return ChannelDiagnosis(channel=joint, final=final, accepted=[named], **about)


@pytest.mark.parametrize(
    ("parameter", "unit", "own", "other", "disagree"),
    [
        ("encoder_zero.joint_3", "rad", (-0.106, 0.006), (-0.192, 0.001), True),
        ("encoder_zero.joint_3", "rad", (-0.106, 0.03), (-0.192, 0.001), False),  # within their errors
        ("encoder_zero.joint_3", "rad", (-0.106, None), (-0.192, 0.001), False),  # not determined
        ("payload.mass", "kg", (0.3, 1e-5), (0.301, 1e-5), False),  # nearly the same
        ("payload.mass", "kg", (0.35, 0.003), (0.292, 0.001), True),
        ("gravity_tilt.tilt", "N m", (0.5, 0.01), (2.0, 0.01), False),  # of two pendulums
        ("coulomb_friction.force", "N m", (0.5, 0.01), (2.0, 0.01), False),  # each joint has its own
    ],
)
def test_parameters_of_the_arm_are_the_same_in_all_joints(parameter, unit, own, other, disagree):
    joints = [
        diagnosed(*("joint_1", parameter), *own, unit),
        diagnosed(*("joint_2", parameter), *other, unit),
    ]
    first, second = with_cautions(joints)
    assert (len(first.cautions), len(second.cautions)) == (disagree, disagree)
    if disagree:
        assert f"{parameter} is {own[0]:.3g} ± " in first.cautions[0]
        assert f" in joint_1, but {other[0]:.3g} ± " in first.cautions[0]


def test_contradiction_with_the_best_known_value_is_stated():
    name = "encoder_zero.joint_3"
    values = ((-0.106, 0.006), (0.041, 0.03), (-0.192, 0.001))
    joints = [diagnosed(f"joint_{n}", name, *value, "rad") for n, value in enumerate(values, 1)]
    (text,) = with_cautions(joints)[0].cautions
    assert "joint_3" in text.partition("but")[2]


def test_different_parameters_contradict_nothing():
    joints = [diagnosed(f"joint_{n}", f"encoder_zero.joint_{n}", 0.1 * n, 1e-3, "rad") for n in (1, 2)]
    assert not any(entry.cautions for entry in with_cautions(joints))


@pytest.mark.parametrize(("offset", "is_doubtful"), [(0.05, True), (0.005, False)])
def test_depth_of_a_contact_is_doubtful_beside_a_wrong_encoder_zero(offset, is_doubtful):
    contact = diagnosed("contact", "stiffness.k", 489.2, 0.1, "N/m")
    joint = diagnosed("joint_2", "encoder_zero.joint_2", offset, 0.003, "rad")
    cautions = with_cautions([contact, joint])[0].cautions
    assert [text.partition(":")[0] for text in cautions] == ["joint_2"] * is_doubtful


@pytest.mark.parametrize(
    ("alternatives", "clear", "mass", "complete", "is_replaced"),
    [
        (["payload"], [], 0.0685, True, True),
        (["payload"], [], 0.09, True, False),  # another payload than joint 2 carries
        (["payload"], [], 0.0685, False, False),  # the payload alone does not explain joint 1
        (["payload"], ["torque_gain"], 0.0685, True, False),  # joint 2 does not show the payload clearly
        (["payload"], [], None, True, False),  # the payload of joint 1 is not determined
        ([], [], 0.0685, True, False),  # joint 1 excludes a payload
        (["coulomb_friction"], [], 0.0685, True, False),
    ],
)
def test_effect_gives_way_to_one_of_the_arm_that_another_joint_shows(
    monkeypatch, alternatives, clear, mass, complete, is_replaced
):
    zero = diagnosed("joint_1", "encoder_zero.joint_3", 0.31, 0.05, "rad", alternatives)
    carried = {
        "joint_1": diagnosed(
            *("joint_1", "payload.mass", mass or 9.0, 5e-4 if mass else None, "kg"), complete=complete
        ),
        "joint_2": diagnosed("joint_2", "payload.mass", 0.0683, 3e-4, "kg", clear),
    }

    def judge(data, model, effects, rng, progress):
        left_out = EFFECTS.keys() - {effect.name for effect in effects}
        assert left_out <= {"encoder_zero"}
        has_zero = not left_out
        return zero if data.name == "joint_1" and has_zero else carried[data.name]

    monkeypatch.setattr(import_module("palpate.estimation.diagnosis.diagnose"), "diagnose_channel", judge)
    joints = [replace(some_channel(ChannelKind.REVOLUTE), name=name) for name in ("joint_1", "joint_2")]
    first, second = diagnose(joints, Model("rigid", (Inertia(),)), rng=np.random.default_rng(1)).channels
    assert first is (carried["joint_1"] if is_replaced else zero)
    assert second is carried["joint_2"]


def test_only_effects_of_the_arm_that_another_channel_shows_replace_others():
    bias = diagnosed("joint_1", "bias.offset", 0.3, 0.01, "N m", ["gravity_tilt", "payload"])
    own = diagnosed("joint_1", "payload.mass", 0.3, 0.01, "kg")
    both = bias.model_copy(update={"accepted": [*bias.accepted, *own.accepted], "final": own.final})
    pendulum = diagnosed("joint_2", "gravity_tilt.tilt", 0.5, 0.01, "N m")  # not an angle of the arm
    assert replaceable_effects([both, pendulum]) == []
    arm = diagnosed("joint_2", "gravity_tilt.tilt", 0.05, 0.001, "rad")
    assert replaceable_effects([both, arm]) == [("joint_1", "bias", "gravity_tilt")]
