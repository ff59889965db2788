"""Joints that state different values of one parameter of the arm."""

import pytest

from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.diagnosis.agreement import with_cautions
from palpate.estimation.diagnosis.result import FitSummary, ParameterValue


def diagnosed(joint, parameter, value, std_err, unit):
    values = {parameter: ParameterValue(value=value, std_err=std_err, unit=unit)}
    final = FitSummary(rmse=0.1, parameters=values)
    return ChannelDiagnosis(channel=joint, verdict="missing", reason="r", effort_unit="N m", final=final)


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
