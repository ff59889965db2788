"""Channels of one robot are judged at once, and again where they depend on what another showed."""

from estimation.diagnosis.robot import judge_robot

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.effects import EFFECTS
from estimation.model import Model
from tests.estimation.diagnosis.test_true_force import EVERY, WIDTH_N, judged, pressing

ARM = Model("rigid_body", (EFFECTS["rigid_body"](),))


def judge(accepted):
    """The recorded joint, and both channels as they were judged, the joint given first; which ran when."""
    contact, joint, _ = pressing()
    seen, asked = judged(contact, **accepted), []

    def run(numbers, made, models):
        asked.extend(numbers)
        told = {"verdict": Verdict.ADEQUATE, "effort_unit": "N m", "reason": "as it was"}
        return [
            seen.found if data.name == "contact" else ChannelDiagnosis(channel=data.name, **told)
            for data in made
        ]

    return joint, judge_robot([joint, contact], [ARM, seen.model], EVERY, run), asked


def test_a_joint_is_judged_again_by_the_contact_s_force_and_handed_on_with_it():
    joint, (of_joint, of_contact), asked = judge({"deadband": {"width": WIDTH_N}})
    assert asked == [0, 1, 0]
    assert [of_joint.data.name, of_contact.data.name] == ["joint_1", "contact"]
    assert of_joint.data.context["contact_force"].max() > joint.context["contact_force"].max() + 0.9 * WIDTH_N
    assert of_joint.found.reason == (
        "as it was; judged by the force of the contact's model, ahead of the sensor's deadband"
    )


def test_a_joint_is_judged_as_recorded_where_no_sensor_is_at_fault():
    joint, (of_joint, _), asked = judge({"cubic_stiffness": {"k3": 1e5}})
    assert asked == [0, 1]
    assert of_joint.data is joint
    assert of_joint.found.reason == "as it was"
