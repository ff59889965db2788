"""Joints carry what the tip pushes with, whatever the force sensor says of it."""

import numpy as np
import pytest
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.true_force import borne_out, with_true_force

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import ChannelDiagnosis, Verdict, diagnose
from estimation.diagnosis.result import Accepted, Fitted, ParameterValue
from estimation.effects import EFFECTS
from estimation.fresh_runs import on_clocks_of_their_own
from estimation.model import Model
from estimation.signals.arm_signals import LEVER, TOUCH

WIDTH_N, STIFFNESS_N_M, DAMPING_N_S_M, RUNS, STEP_S = 0.4, 500.0, 20.0, 3, 0.01
EVERY = [effect() for effect in EFFECTS.values()]


def pressing(noise_n=0.0, noise_nm=0.0, width_n=WIDTH_N):
    """A contact under a sensor with a dead band, and a joint that carries the force: reading, true force."""
    t, rng = np.tile(np.arange(0.0, 4.0, STEP_S), RUNS), np.random.default_rng(6)
    run = np.repeat(np.arange(RUNS), len(t) // RUNS)
    time_s = t + 5.0 * run
    depth = 0.015 * np.sin((1.5 + 0.3 * run) * t) - 0.002
    speed = 0.015 * (1.5 + 0.3 * run) * np.cos((1.5 + 0.3 * run) * t)
    true_n = np.where(depth > 0.0, np.maximum(STIFFNESS_N_M * depth + DAMPING_N_S_M * speed, 0.0), 0.0)
    reading_n = np.maximum(true_n - width_n, 0.0) + rng.normal(0.0, 1.0, len(t)) * noise_n
    phase, still = np.full(len(t), -1), np.zeros(len(t))
    contact = ChannelData("contact", ChannelKind.CONTACT, time_s, depth, speed, still, reading_n, run, phase)
    angle, turn = 0.5 + 0.1 * np.sin(2.0 * t + run), 0.2 * np.cos(2.0 * t + run)
    lever = 0.4 * np.cos(angle)
    context = {
        "rigid_body_torque": 6.0 * np.cos(angle),
        "contact_force": reading_n,
        LEVER: lever,
        TOUCH: lever * reading_n,
        "touching": (true_n > WIDTH_N).astype(float),
    }
    effort = 6.0 * np.cos(angle) + lever * true_n + rng.normal(0.0, 1.0, len(t)) * noise_nm
    motion = (time_s, angle, turn, -4.0 * (angle - 0.5))
    joint = ChannelData("joint_1", ChannelKind.REVOLUTE, *motion, effort, run, phase, context)
    return contact, joint, true_n


def judged(contact, **accepted):
    """The contact with what was found: parameters of each effect beside spring and damper."""
    fitted = {"stiffness.k": STIFFNESS_N_M, "damping.c": DAMPING_N_S_M}
    texts = dict.fromkeys(("physics", "equation", "signature"), "")
    entries = []
    for effect, parameters in accepted.items():
        fitted |= {f"{effect}.{name}": value for name, value in parameters.items()}
        entries.append(
            Accepted(
                effect=effect,
                parameters={},
                rmse_before=1.0,
                rmse_after=0.1,
                p_value=0.0,
                confused_with=[],
                **texts,
            )
        )
    values = {name: ParameterValue(value=v, std_err=None, unit="") for name, v in fitted.items()}
    found = ChannelDiagnosis(
        channel="contact",
        verdict=Verdict.MISSING,
        reason="",
        effort_unit="N",
        accepted=entries,
        final=Fitted(rmse=0.1, parameters=values),
    )
    return Judged(contact, Model("kelvin_voigt", (EFFECTS["stiffness"](), EFFECTS["damping"]())), found)


def test_a_fault_of_the_sensor_that_the_contact_shows_is_taken_off_the_joint_s_load():
    contact, joint, true_n = pressing()
    seen = judged(contact, deadband={"width": WIDTH_N}, bias={"offset": 0.2})
    mended = with_true_force(joint, [seen], EVERY)
    assert mended.context["contact_force"] == pytest.approx(true_n, abs=1e-9)
    assert mended.context[TOUCH] == pytest.approx(joint.context[LEVER] * true_n, abs=1e-9)
    assert mended.context["rigid_body_torque"] is joint.context["rigid_body_torque"]


def test_what_an_object_does_is_no_fault_of_its_sensor():
    contact, joint, _ = pressing()
    assert with_true_force(joint, [judged(contact, cubic_stiffness={"k3": 1e5})], EVERY) is joint
    assert with_true_force(joint, [], EVERY) is joint
    assert with_true_force(contact, [judged(contact, deadband={"width": WIDTH_N})], EVERY) is contact


@pytest.mark.parametrize("clocks", [lambda data: data, on_clocks_of_their_own])
def test_a_contact_speaks_for_its_own_runs_whichever_was_probed_in_between(clocks):
    contact, joint, true_n = pressing()
    contact, joint = clocks(contact), clocks(joint)
    here, there = contact.of_runs(np.array([0, 2])), contact.of_runs(np.array([1]))
    seen = [judged(here, deadband={"width": WIDTH_N}), judged(there, cubic_stiffness={"k3": 1e5})]
    used_n, between = with_true_force(joint, seen, EVERY).context["contact_force"], joint.run == 1
    assert used_n[~between] == pytest.approx(true_n[~between], abs=1e-9)
    assert used_n[between] == pytest.approx(joint.context["contact_force"][between], abs=1e-12)


@pytest.mark.parametrize(
    ("verdict", "rivals", "taken"),
    [
        (Verdict.MISSING, ["lag"], True),  # whichever it is, the sensor is at fault
        (Verdict.MISSING, ["lag", "contact_offset"], False),
        (Verdict.UNEXPLAINED, [], False),
    ],
)
def test_a_fault_that_may_be_no_fault_is_left_to_the_joints(verdict, rivals, taken):
    contact, joint, _ = pressing()
    seen = judged(contact, deadband={"width": WIDTH_N})
    (entry,) = seen.found.accepted
    unsure = {"verdict": verdict, "accepted": [entry.model_copy(update={"confused_with": rivals})]}
    seen = Judged(contact, seen.model, seen.found.model_copy(update=unsure))
    assert (with_true_force(joint, [seen], EVERY) is not joint) is taken


@pytest.mark.parametrize(
    ("named", "believed"),
    [
        ({"deadband": {"width": WIDTH_N}}, True),
        ({"deadband": {"width": 5.0 * WIDTH_N}, "bias": {"offset": 0.1}}, False),  # the joint fits worse
        ({"cubic_stiffness": {"k3": 1e5}}, False),
    ],
)
def test_a_fault_in_an_unexplained_contact_is_believed_where_the_joints_bear_it_out(named, believed):
    contact, joint, true_n = pressing(noise_nm=0.02)
    seen = judged(contact, **named)
    force = 5.0 if "bias" in named else 1.0  # the same spring under five times the dead band pushes harder
    values = {
        name: value.model_copy(update={"value": force * value.value})
        for name, value in seen.found.final.parameters.items()
    }
    told = {"verdict": Verdict.UNEXPLAINED, "final": Fitted(rmse=0.1, parameters=values)}
    seen = Judged(contact, seen.model, seen.found.model_copy(update=told))
    arm = Model("rigid_body", (EFFECTS["rigid_body"](),))
    witness = Judged(joint, arm, seen.found)
    marked = borne_out(seen, [witness], EVERY)
    assert marked.borne_out == believed
    assert (with_true_force(joint, [marked], EVERY) is not joint) == believed
    if believed:
        assert with_true_force(joint, [marked], EVERY).context["contact_force"] == pytest.approx(true_n)


@pytest.mark.parametrize(
    "named", [{"lag": {"tau": 0.003}}, {"hysteresis": {"width": 0.05}}, {"deadband": {"width": 0.02}}]
)
def test_a_noisy_sensor_is_not_at_fault_because_a_model_has_no_noise(named):
    contact, joint, _ = pressing(noise_n=0.1, noise_nm=0.02, width_n=0.0)
    seen = judged(contact, **named)
    seen = Judged(contact, seen.model, seen.found.model_copy(update={"verdict": Verdict.UNEXPLAINED}))
    arm = Model("rigid_body", (EFFECTS["rigid_body"](),))
    assert not borne_out(seen, [Judged(joint, arm, seen.found)], EVERY).borne_out


def test_a_joint_shows_the_dead_band_that_to_the_contact_is_a_deeper_surface():
    _, joint, _ = pressing(noise_n=0.02, noise_nm=0.02)
    library = [
        EFFECTS[n]() for n in ("force_deadband", "torque_gain", "bias", "joint_spring", "gravity_tilt")
    ]
    arm = Model("rigid_body", (EFFECTS["rigid_body"](),))
    found = diagnose(joint, arm, library, rng=np.random.default_rng(1)).channels[0]
    assert [entry.effect for entry in found.accepted] == ["force_deadband"]
    assert found.accepted[0].confused_with == []
    assert found.accepted[0].parameters["width"].value == pytest.approx(WIDTH_N, rel=0.05)
