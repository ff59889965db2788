"""Joints of one arm that tell on each other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from estimation.diagnosis.common_cause import agreed, settle
from estimation.diagnosis.judged import Judged

import sim_backend
from control.arm.rigid_body import RigidBody
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.diagnosis.result import Accepted
from estimation.effects import EFFECTS
from estimation.model import Model
from estimation.signals.arm_signals import with_rigid_body

URDF = Path(sim_backend.__file__).parent / "arms/follower/follower.urdf"
HOME_RAD = np.array([0.87, -1.47, -0.98])
STEP_S, RUNS, NOISE_NM = 0.02, 3, 0.02
ARM = Model("rigid_body", (EFFECTS["rigid_body"](),))
LIBRARY = [
    EFFECTS[name]()
    for name in ("bias", "joint_spring", "gravity_tilt", "payload", "torque_gain", "force_deadband")
]


def joints(added):
    """Three joints of an arm that hardly moves; `added` gives each one's extra torque from its signals."""
    t, rng = np.arange(0.0, 3.0, STEP_S), np.random.default_rng(2)
    swings = [HOME_RAD + 0.03 * np.sin(np.outer(t, [1.3, 1.7, 2.1]) + run) for run in range(RUNS)]
    q = np.concatenate(swings)
    v = np.concatenate([np.gradient(swing, STEP_S, axis=0) for swing in swings])
    a = np.concatenate([np.gradient(speed, STEP_S, axis=0) for speed in np.split(v, RUNS)])
    run, body = np.repeat(np.arange(RUNS), len(t)), RigidBody.from_urdf(URDF, "tip")
    context = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    context |= {"contact_force": 0.0 * run, "touching": np.tile(1.0 * (np.sin(2.0 * t) > 0.0), RUNS)}
    context["press_direction_world"] = np.tile([0.0, 0.0, -1.0], (len(run), 1))
    made = []
    for joint in range(3):
        motion = (np.tile(t, RUNS), q[:, joint], v[:, joint], a[:, joint])
        bare = ChannelData(
            f"joint_{joint + 1}",
            ChannelKind.REVOLUTE,
            *motion,
            0.0 * run,
            run,
            np.full(len(run), -1),
            context,
        )
        known = with_rigid_body(bare, body, joint)
        noise = rng.normal(0.0, NOISE_NM, len(run))
        effort = known.context["rigid_body_torque"] + added(joint, known) + noise
        motion = (known.time_s, known.position, known.velocity, known.acceleration, effort)
        made.append(ChannelData(known.name, known.kind, *motion, run, known.phase, context=known.context))
    return made


def answer(name, *group):
    """As a joint would answer alone: one of a group, or adequate."""
    entry = {"rmse_before": 1.0, "rmse_after": 0.02, "p_value": 0.0, "parameters": {}}
    entry |= dict.fromkeys(("physics", "equation", "signature"), "")
    accepted = [Accepted(effect=group[0], confused_with=list(group[1:]), **entry)] if group else []
    verdict = Verdict.MISSING if group else Verdict.ADEQUATE
    return ChannelDiagnosis(
        channel=name, verdict=verdict, reason="as it was", effort_unit="N m", accepted=accepted
    )


def settled(data, group):
    """What becomes of a group that joint 1 cannot decide on; the other joints are adequate."""
    answers = [answer("joint_1", *group), answer("joint_2"), answer("joint_3")]
    return settle([Judged(d, ARM, found) for d, found in zip(data, answers, strict=True)], LIBRARY), answers


def payload(mass_kg):
    return lambda joint, data: mass_kg * data.context["payload_effort_per_kg"]


def test_a_load_that_one_joint_cannot_tell_from_a_bias_is_known_by_the_others():
    (first, *_), _ = settled(joints(payload(0.1)), ("bias", "payload"))
    (entry,) = first.accepted
    assert (entry.effect, entry.confused_with) == ("payload", [])
    assert entry.parameters["mass"].value == pytest.approx(0.1, abs=0.005)
    assert first.final.parameters["payload.mass"] == entry.parameters["mass"]
    assert "the same is in joint_2" in first.reason
    assert first.noise_floor == pytest.approx(NOISE_NM, rel=0.1)
    assert first.floor.value == first.noise_floor
    assert first.next_experiment is None


def test_a_bias_of_one_joint_is_no_load_where_the_others_carry_none():
    found, answers = settled(
        joints(lambda joint, data: 0.3 * (joint == 0)), ("payload", "bias", "torque_gain")
    )
    (entry,) = found[0].accepted
    assert (entry.effect, entry.confused_with) == ("bias", ["torque_gain"])
    assert entry.parameters["offset"].value == pytest.approx(0.3, abs=0.005)
    assert "no payload: that of joint_2" in found[0].reason
    assert found[0].next_experiment.separates == ["bias", "torque_gain"]
    assert found[1:] == answers[1:]


def test_a_spring_is_not_hidden_by_a_tilt_that_would_have_to_be_in_all_joints():
    def spring(joint, data):
        """As stiff as the tilt of 0.2 rad that looks like it."""
        tilt = EFFECTS["gravity_tilt"]().suited_to(data).known(data, {"tilt": 0.2})
        stiffness, preload = np.polyfit(data.position, tilt, 1)
        return (stiffness * data.position + preload) * (joint == 0)

    (first, *_), _ = settled(joints(spring), ("gravity_tilt", "joint_spring"))
    (entry,) = first.accepted
    assert (entry.effect, entry.confused_with) == ("joint_spring", [])
    assert "no gravity_tilt" in first.reason


def test_a_joint_without_others_keeps_its_group():
    made = joints(payload(0.1))[0]
    alone = answer("joint_1", "bias", "payload")
    assert settle([Judged(made, ARM, alone)], LIBRARY) == [alone]


def test_a_joint_that_cannot_say_is_not_asked():
    made = joints(lambda joint, data: 0.3 * (joint == 0))
    unsure = answer("joint_2").model_copy(update={"verdict": Verdict.UNEXPLAINED})
    answers = [answer("joint_1", "payload", "bias"), unsure]
    pairs = zip(made[:2], answers, strict=True)
    assert settle([Judged(data, ARM, found) for data, found in pairs], LIBRARY) == answers


def load_and_bias(joint, data):
    """A load in all joints, and a bias in the second, which so shows another load."""
    return payload(0.1)(joint, data) + 0.3 * (joint == 1)


def test_joints_that_cannot_tell_do_not_contradict_each_other_out_of_a_cause():
    data = joints(load_and_bias)
    answers = [answer(each.name, "payload", "bias") for each in data]
    pairs = zip(data, answers, strict=True)
    assert settle([Judged(each, ARM, found) for each, found in pairs], LIBRARY) == answers


def test_a_joint_that_cannot_tell_rules_nothing_out():
    data = joints(lambda joint, data: (0.3, -0.3, 0.0)[joint])[:2]
    answers = [answer(each.name, "payload", "bias") for each in data]
    pairs = zip(data, answers, strict=True)
    assert settle([Judged(each, ARM, found) for each, found in pairs], LIBRARY) == answers


def test_a_joint_that_cannot_tell_is_not_heard_against_one_that_can():
    data = joints(load_and_bias)
    answers = [answer("joint_1", "bias", "payload"), answer("joint_2", "bias", "payload"), answer("joint_3")]
    first, *_ = settle([Judged(*pair) for pair in zip(data, [ARM] * 3, answers, strict=True)], LIBRARY)
    assert [entry.effect for entry in first.accepted] == ["payload"]
    assert "joint_2" not in first.reason


def test_nothing_is_put_in_the_place_of_a_cause_that_leaves_more_than_noise():
    """The load's own curve, in one joint alone: no load, but no bias either."""
    found, answers = settled(
        joints(lambda joint, data: 3 * (joint == 0) * payload(0.1)(0, data)), ("payload", "bias")
    )
    assert found == answers


def test_a_dead_band_of_the_force_sensor_has_one_width_in_all_joints():
    key = "contact_torque_per_newton"
    swallowed = joints(lambda joint, data: 0.4 * data.context[key] * data.context["touching"])
    (first, *_), _ = settled(swallowed, ("torque_gain", "force_deadband"))
    (entry,) = first.accepted
    assert (entry.effect, entry.confused_with) == ("force_deadband", [])
    assert entry.parameters["width"].value == pytest.approx(0.4, abs=0.05)


def swallowed(width_n):
    """What joint k carries of a force of which the sensor swallows this much, by joint."""
    key = "contact_torque_per_newton"
    return lambda joint, data: width_n[joint] * data.context[key] * data.context["touching"]


def named_by(data, *numbers):
    """Those joints surely name a dead band of the force sensor; the others are adequate."""
    answers = [answer(one.name, *["force_deadband"] * (i in numbers)) for i, one in enumerate(data, start=1)]
    return [Judged(one, ARM, found) for one, found in zip(data, answers, strict=True)]


def never_touching(joint):
    """The joint where it cannot say how much the sensor swallows."""
    return replace(joint, context={**joint.context, "touching": np.zeros(len(joint))})


def test_a_joint_that_does_not_determine_a_common_cause_does_not_speak_for_the_others():
    first, *others = joints(swallowed((0.4, 0.4, 0.4)))
    value, told_by = agreed(named_by([never_touching(first), *others], 1, 2), "force_deadband", LIBRARY)
    assert value.value == pytest.approx(0.4, abs=0.05)
    assert np.isfinite(value.std_err)
    assert [one.data.name for one in told_by] == ["joint_2"]


def test_joints_that_differ_agree_no_more_for_one_that_does_not_determine_it():
    first, *others = joints(swallowed((0.4, 0.4, 4.0)))
    blind = never_touching(first)
    assert agreed(named_by([blind, *others], 1, 2, 3), "force_deadband", LIBRARY) is None
    assert agreed(named_by([blind], 1), "force_deadband", LIBRARY) is None
