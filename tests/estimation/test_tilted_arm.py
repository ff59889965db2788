"""Joints of known arms: a tilted base, wrong encoder zeros, a resting joint, a pressing arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate import sim_backend
from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.diagnosis import Verdict, diagnose
from palpate.estimation.diagnosis.agreement import contradicted_effect
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.gravity_load import KnownRigidBody
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.model import Model
from palpate.estimation.signals.arm_signals import with_rigid_body
from palpate.estimation.signals.runwise import shifted_motion
from palpate.estimation.study.estimates import estimate_with
from palpate.robot_io.calibration.applied import gravity_base_m_s2
from tests.estimation.press_tables import imported
from tests.palpate.test_feedforward import PENDULUM

URDF = Path(sim_backend.__file__).parent / "arms/follower/follower.urdf"
TURNING = URDF.read_text().replace('"0 -1 0"', '"0 0 1"', 1)  # its first axis is vertical
HOME_RAD = np.array([0.87, -1.47, -0.98])
STEP_S, RUNS = 0.01, 3


def swinging(joint, dip_rad, swing_rad=0.1, noise_nm=0.0, urdf=URDF, roll_rad=0.0, zeros_rad=(0.0, 0.0, 0.0)):
    """Slow swings of an arm whose base dips to its front and side and whose encoders have wrong zeros."""
    t = np.arange(0.0, 4.0, STEP_S)
    swings = [HOME_RAD + swing_rad * np.sin(np.outer(t, [1.3, 1.7, 2.1]) + run) for run in range(RUNS)]
    q = np.concatenate(swings)
    v = np.concatenate([np.gradient(swing, STEP_S, axis=0) for swing in swings])
    a = np.concatenate([np.gradient(speed, STEP_S, axis=0) for speed in np.split(v, RUNS)])
    tilted = RigidBody.from_urdf(urdf, "tip", gravity_base_m_s2(dip_rad, roll_rad))
    torque = np.array([tilted.inverse_dynamics(*rows)[joint] for rows in zip(q, v, a, strict=True)])
    torque += np.random.default_rng(4).normal(0.0, 1.0, len(torque)) * noise_nm
    run, q = np.repeat(np.arange(RUNS), len(t)), q + zeros_rad
    context = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    motion = (np.tile(t, RUNS), q[:, joint], v[:, joint], a[:, joint])
    name = f"joint_{joint + 1}"
    data = ChannelData(name, ChannelKind.REVOLUTE, *motion, torque, run, np.full(len(run), -1), context)
    return with_rigid_body(data, RigidBody.from_urdf(urdf, "tip"), joint)


@pytest.mark.parametrize(("joint", "dip_rad"), [(0, 0.14), (1, -0.6), (2, -0.6)])
def test_tilted_base_equals_tilted_gravity(joint, dip_rad):
    data = swinging(joint, dip_rad)
    tilt = EFFECTS["gravity_tilt"]().suited_to(data)
    added = tilt.known(data, {"tilt": dip_rad})  # about y, though the follower's joints turn about -y
    np.testing.assert_allclose(data.effort - data.context["rigid_body_torque"], added, atol=1e-9)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_torque_is_right_even_where_a_gap_shifts_the_angle_far(joint):
    data, shift, still = swinging(joint, 0.0), np.array([0.6]), np.zeros(1)
    shifted = shifted_motion(data.select(np.array([90])), shift, still, still).context["rigid_body_torque"]
    moved = {**data.context, "joint_position": data.context["joint_position"] + shift * np.eye(3)[joint]}
    there = with_rigid_body(replace(data, context=moved), RigidBody.from_urdf(URDF, "tip"), joint)
    change = there.context["rigid_body_torque"][90] - data.context["rigid_body_torque"][90]
    assert shifted[0] - data.context["rigid_body_torque"][90] == pytest.approx(change, rel=2e-3)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_base_of_a_turning_arm_has_two_angles(joint):
    data = swinging(joint, 0.5, swing_rad=0.6, urdf=TURNING, roll_rad=-0.3)
    tilt = EFFECTS["gravity_tilt"]().suited_to(data)
    added = tilt.known(data, {"pitch": 0.5, "roll": -0.3})
    np.testing.assert_allclose(data.effort - data.context["rigid_body_torque"], added, atol=1e-9)
    assert tilt.applies_to(data)


def test_arm_of_one_inclined_joint_has_tilt_signals_too():
    inclined = PENDULUM.replace('"0 -1 0"', '"0 0.6 0.8"')
    q, rest, run = np.linspace(-1.0, 1.0, 5), np.zeros(5), np.zeros(5, dtype=np.int64)
    context = {f"joint_{what}": q * (what == "position") for what in ("position", "velocity", "acceleration")}
    alone = ChannelData("joint_1", ChannelKind.REVOLUTE, q, q, rest, rest, rest, run, run, context)
    ready = with_rigid_body(alone, RigidBody.from_urdf(inclined, "probe"), 0)
    dipped = RigidBody.from_urdf(inclined, "probe", gravity_base_m_s2(0.2, 0.1))
    expected = dipped.inverse_dynamics_batch(q[:, None], *np.zeros((2, 5, 1)))[:, 0]
    added = EFFECTS["gravity_tilt"]().suited_to(ready).known(ready, {"pitch": 0.2, "roll": 0.1})
    np.testing.assert_allclose(ready.context["rigid_body_torque"] + added, expected, atol=1e-9)


@pytest.mark.parametrize("joint", [0, 2])
def test_tilt_of_a_turning_arm_is_named_with_both_angles(joint):
    angles = {"pitch": 0.04, "roll": -0.03}
    data = swinging(joint, angles["pitch"], 0.6, noise_nm=0.005, urdf=TURNING, roll_rad=angles["roll"])
    effects = [EFFECTS[name]() for name in ("gravity_tilt", "joint_spring", "bias", "torque_gain", "payload")]
    model, rng = Model("arm", (KnownRigidBody(),)), np.random.default_rng(1)
    (entry,) = diagnose(data, model, effects, rng=rng).channels[0].accepted
    assert entry.effect == "gravity_tilt"
    for name, true in angles.items():
        fitted = entry.parameters[name]
        assert abs(fitted.value - true) < 4.0 * fitted.std_err < 0.02


def test_a_vertical_joint_is_not_fitted_upside_down():
    """In a base that is upside down, its torque would be the same."""
    data = swinging(0, 0.04, 0.6, urdf=TURNING, roll_rad=-0.03)
    tilt = EFFECTS["gravity_tilt"]().suited_to(data)
    upright, turned = (tilt.known(data, {"pitch": 0.1, "roll": roll}) for roll in (0.2, np.pi - 0.2))
    np.testing.assert_allclose(upright, turned, atol=1e-9)
    assert all(-np.pi / 2 <= angle.lower < angle.upper <= np.pi / 2 for angle in tilt.inner)


def test_tilt_is_no_spring_though_the_joint_moves_little():
    """A tenth of a radian of swing, and 1 % of the weight that the tilt takes off: more than half of it."""
    data = swinging(0, dip_rad=0.14, noise_nm=0.01)
    effects = [EFFECTS[name]() for name in ("gravity_tilt", "joint_spring", "cubic_stiffness", "bias")]
    model, rng = Model("arm", (KnownRigidBody(),)), np.random.default_rng(1)
    found = diagnose(data, model, effects, rng=rng).channels[0]
    assert found.verdict is Verdict.MISSING
    (entry,) = found.accepted
    assert entry.effect == "gravity_tilt"
    tilt = entry.parameters["tilt"]
    assert tilt.unit == "rad"
    assert abs(tilt.value - 0.14) < 3.0 * tilt.std_err < 0.03


def test_joint_on_a_tilted_base_is_no_pendulum():
    """What a tilt takes is not computed where the first axis is not level: then nothing is said of it."""
    arm, tilt = swinging(1, dip_rad=0.0), EFFECTS["gravity_tilt"]()
    lacking = {k: v for k, v in arm.context.items() if k not in {"tilt_effort_per_rad", "weight_effort"}}
    assert tilt.applies_to(arm)
    assert not tilt.applies_to(replace(arm, context=lacking))
    assert tilt.applies_to(replace(arm, context={}))  # a single joint


SLIDING = '"1 0 0"'.join(URDF.read_text().rsplit('"0 -1 0"', 1))  # the last joint moves along its link
SLIDING = 'type="prismatic"'.join(SLIDING.rsplit('type="revolute"', 1))


@pytest.mark.parametrize(("size", "tolerance"), [(1.0, 0.01), (1e-3, 1e-5)])
@pytest.mark.parametrize(("urdf", "joint"), [(URDF, 0), (URDF, 1), (URDF, 2), (TURNING, 1), (SLIDING, 1)])
def test_wrong_zeros_equal_torques_of_another_posture(urdf, joint, size, tolerance):
    """The tool turns with the wrong zeros, and measures only a component of the contact force."""
    rng, count = np.random.default_rng(2), 50
    q, v, a = rng.uniform(-1.0, 1.0, (3, count, 3))
    force_n, down = rng.uniform(0.0, 20.0, count), np.tile([0.6, 0.0, -0.8], (count, 1))
    body, zeros_rad = RigidBody.from_urdf(urdf, "tip"), size * np.array([0.05, -0.1, 0.08])
    zeros_rad *= [axis.revolute for axis in body.joint_axes()]

    def torque(true_q):
        turned = [
            body.tip_pose(true)[1] @ body.tip_pose(read)[1].T for true, read in zip(true_q, q, strict=True)
        ]
        shares = np.einsum("ni,nij,nj->n", down, np.array(turned), down)
        levers_m = np.array([body.tip_jacobian(row)[:3].T @ p for row, p in zip(true_q, down, strict=True)])
        return body.inverse_dynamics_batch(true_q, v, a)[:, joint] + levers_m[:, joint] * force_n / shares

    context = dict(zip(("joint_position", "joint_velocity", "joint_acceleration"), (q, v, a), strict=True))
    context |= {"contact_force": force_n, "press_direction_world": down}
    effort, run = torque(q - zeros_rad), np.zeros(count, dtype=np.int64)
    motion = (0.01 * np.arange(count), q[:, joint], v[:, joint], a[:, joint])
    data = ChannelData(f"joint_{joint + 1}", ChannelKind.REVOLUTE, *motion, effort, run, run, context)
    data = with_rigid_body(data, body, joint)
    effect = EFFECTS["encoder_zero"]().suited_to(data)
    assert len(effect.inner) == np.sum(zeros_rad != 0.0)  # a slide has no angle
    offsets = {angle.name: zeros_rad[j] for angle, j in zip(effect.inner, effect.joints, strict=True)}
    change = effort - torque(q)
    np.testing.assert_allclose(effect.known(data, offsets), change, atol=tolerance * np.abs(change).max())


def test_joint_that_carries_no_weight_shows_no_zero():
    q, rest, run = np.linspace(-1.0, 1.0, 5), np.zeros(5), np.zeros(5, dtype=np.int64)
    context = {f"joint_{what}": q * (what == "position") for what in ("position", "velocity", "acceleration")}
    alone = ChannelData("joint_1", ChannelKind.REVOLUTE, q, q, rest, rest, rest, run, run, context)
    upright = RigidBody.from_urdf(PENDULUM.replace('"0 -1 0"', '"0 0 1"'), "probe")
    assert not EFFECTS["encoder_zero"]().applies_to(with_rigid_body(alone, upright, 0))


@pytest.mark.parametrize(("joint", "zeros_rad"), [(0, (0.0, 0.06, 0.0)), (2, (0.0, 0.0, -0.2))])
def test_wrong_zero_of_an_encoder_is_named(joint, zeros_rad):
    """The last joint shows only the sum of all zeros, since its weight depends on the link's direction."""
    data = swinging(joint, 0.0, 0.6, noise_nm=0.005, zeros_rad=zeros_rad)
    effects = [EFFECTS[name]() for name in ("encoder_zero", "joint_spring", "bias", "torque_gain", "payload")]
    model, rng = Model("arm", (KnownRigidBody(),)), np.random.default_rng(1)
    (entry,) = diagnose(data, model, effects, rng=rng).channels[0].accepted
    assert entry.effect == "encoder_zero"
    fitted = list(entry.parameters.values())
    if joint == 0:
        assert all(
            abs(p.value - zero) < 4.0 * p.std_err < 0.04 for p, zero in zip(fitted, zeros_rad, strict=True)
        )
    assert sum(p.value for p in fitted) == pytest.approx(sum(zeros_rad), abs=0.01)


def test_one_joint_that_presses_shows_its_own_zero():
    q, rest, run = np.linspace(-1.0, 1.0, 5), np.zeros(5), np.zeros(5, dtype=np.int64)
    context = {f"joint_{what}": q * (what == "position") for what in ("position", "velocity", "acceleration")}
    context |= {"contact_force": 10.0 + q, "press_direction_world": np.tile([0.0, 0.0, -1.0], (5, 1))}
    alone = ChannelData("joint_1", ChannelKind.REVOLUTE, q, q, rest, rest, rest, run, run, context)
    ready = with_rigid_body(alone, RigidBody.from_urdf(PENDULUM, "probe"), 0)
    assert EFFECTS["encoder_zero"]().suited_to(ready).joints == (0,)


def test_a_tilt_is_confused_with_a_zero_of_the_first_joint():
    data, tilt, zero = swinging(1, 0.05), EFFECTS["gravity_tilt"](), EFFECTS["encoder_zero"]()
    added = zero.suited_to(data).known(data, {"joint_1": 0.05, "joint_2": 0.0, "joint_3": 0.0})
    np.testing.assert_allclose(added, data.effort - data.context["rigid_body_torque"], atol=1e-4)
    assert zero.name in tilt.confused_with
    assert tilt.name in zero.confused_with


def test_zero_of_a_vertical_joint_changes_no_torque_in_free_air():
    effect = EFFECTS["encoder_zero"]().suited_to(swinging(1, 0.0, urdf=TURNING))
    assert [angle.name for angle in effect.inner] == ["joint_2", "joint_3"]


N = 2500
MOVES = slice(2000, 2400)


def channel_of(torque_of):
    """A joint at rest at zero, that swings once; `torque_of` gives the torque while it does."""
    position, torque = np.zeros(N), np.zeros(N)
    position[MOVES] = 0.3 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 400)))
    torque[MOVES] = torque_of(position[MOVES])
    columns = {"time_s": np.arange(N) / 1000.0, "position_rad": position, "torque_Nm": torque}
    return imported(**columns).channels[0]


@pytest.mark.parametrize(
    ("model", "torque_of"),
    [
        ("pendulum", lambda position: 0.5 * np.sign(np.gradient(position))),
        ("spring_mass_damper", lambda position: np.random.default_rng(0).normal(size=len(position))),
    ],
    ids=["dry friction", "noise"],
)
def test_parameters_without_own_signal_are_undetermined(torque_of, model):
    found = estimate_with(channel_of(torque_of), model, list(ESTIMATORS))
    for one in found.estimates:
        assert not any(p.std_err < 1e-9 for p in one.parameters), (one.estimator, one.parameters)
    assert found.best.estimator != "robust" or found.best.identifiability != "none"


def test_badly_scaled_columns_keep_recursive_estimates_real():
    rng, time_s = np.random.default_rng(1), np.arange(60) * 1e-6  # accelerations of 1e12
    x = rng.normal(size=60)
    columns = {"time_s": time_s, "position_rad": x, "torque_Nm": 300.0 * x + 0.01 * rng.normal(size=60)}
    channel = imported(**columns).channels[0]
    assert estimate_with(channel, "spring_mass_damper", ["cusum_rls"]).estimates


def test_exact_law_is_fitted_to_the_last_digit():
    found = estimate_with(channel_of(lambda position: 0.5 * position), "spring_mass_damper", ["lsq"])
    stiffness = found.best.parameters[-1]
    assert (found.best.identifiability, stiffness.value) == ("good", pytest.approx(0.5, abs=1e-9))
    assert stiffness.std_err < 1e-9


PRESS = np.array([0.0, 0.0, -1.0])


@pytest.fixture
def body():
    return RigidBody.from_urdf(URDF, "tip")


def resting(joint, force_n, n=5):
    """An arm that stands still in random postures and presses downwards."""
    rng = np.random.default_rng(3)
    q, rest, number = rng.uniform(-1, 1, (n, 3)), np.zeros((3, n)), np.zeros(n, dtype=np.int64)
    context = {
        "joint_position": q,
        "joint_velocity": np.zeros((n, 3)),
        "joint_acceleration": np.zeros((n, 3)),
        "contact_force": np.full(n, force_n),
        "press_direction_world": np.tile(PRESS, (n, 1)),
    }
    signals = np.arange(n) * 0.1, q[:, joint], *rest, number, number, context
    return ChannelData(f"joint_{joint + 1}", ChannelKind.REVOLUTE, *signals)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_work_of_the_joints_is_the_work_of_the_tip(body, joint):
    """A small turn moves the tip by d; the torque for the pressing does the force's work along d."""
    step = 1e-6
    data = with_rigid_body(resting(joint, 7.0), body, joint)
    bare = with_rigid_body(resting(joint, 0.0), body, joint)
    extra = EFFECTS["rigid_body"]().known(data, {}) - EFFECTS["rigid_body"]().known(bare, {})
    for q, torque in zip(data.context["joint_position"], extra, strict=True):
        turned = q.copy()
        turned[joint] += step
        moved = body.tip_pose(turned)[0] - body.tip_pose(q)[0]
        assert torque * step == pytest.approx(7.0 * moved @ PRESS, abs=1e-9)


def test_arm_torques_are_computed_once_for_all_joints_of_an_arm(body, monkeypatch):
    calls = []
    whole = RigidBody.inverse_dynamics_batch
    monkeypatch.setattr(
        RigidBody, "inverse_dynamics_batch", lambda self, *motion: calls.append(self) or whole(self, *motion)
    )
    first = resting(0, 7.0)
    with_rigid_body(first, body, 0)
    of_first, calls[:] = len(calls), []
    second = replace(first, name="joint_2", position=first.context["joint_position"][:, 1])
    torque = with_rigid_body(second, RigidBody.from_urdf(URDF, "tip"), 1).context["rigid_body_torque"]
    assert len(calls) == 3 < of_first  # only the slopes by the position and acceleration of this joint
    motion = [first.context[f"joint_{what}"] for what in ("position", "velocity", "acceleration")]
    np.testing.assert_array_equal(torque, whole(body, *motion)[:, 1])
    loaded = body.with_load(0.3)
    heavier = with_rigid_body(second, loaded, 1).context["rigid_body_torque"]
    np.testing.assert_array_equal(heavier, whole(loaded, *motion)[:, 1])
    assert np.abs(heavier - torque).max() > 0.1


def test_fitted_masses_leave_the_contact_to_the_force_sensor(body):
    data = with_rigid_body(resting(0, 7.0), body, 0, regressor=range(30))
    fitted, given = EFFECTS["rigid_body_fitted"](), EFFECTS["rigid_body"]()
    pressing = given.known(data, {}) - data.context["rigid_body_torque"]
    np.testing.assert_allclose(fitted.known(data, {}), pressing)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_other_joints_reveal_what_the_force_sensor_misses(body, joint):
    """The tip is pressed by more than the sensor reads; what the joint itself carries says nothing of it."""
    n, rng = 1200, np.random.default_rng(4)
    still, missed = resting(joint, 7.0, n), 0.8 * np.sin(np.linspace(0.0, 12.0, n))
    q = np.tile([0.3, -0.7, 0.4], (n, 1))
    pushed = np.array([body.tip_jacobian(row)[:3].T @ PRESS for row in q]) * (7.0 + missed)[:, None]
    torque = body.inverse_dynamics_batch(q, 0.0 * q, 0.0 * q) + pushed
    torque += rng.normal(0.0, [0.02, 0.01, 0.005], q.shape)
    torque[:, joint] = rng.normal(0.0, 5.0, n)
    touching = np.append(np.zeros(200), np.ones(n - 200))
    reading = np.where(touching, 7.0, 0.3)  # a sensor that has drifted in free air
    known = {"joint_position": q, "joint_torque": torque, "touching": touching, "contact_force": reading}
    data = replace(still, time_s=0.001 * np.arange(n), context={**still.context, **known})
    found = with_rigid_body(data, body, joint).context["force_beyond_reading"]
    assert found[:170] == pytest.approx(-0.3)
    assert np.sqrt(np.mean((found - missed)[230:] ** 2)) < 0.05


def test_joints_without_a_lever_arm_reveal_no_force(body):
    """Links in line, pressed along that line: two joints carry noise only, and a lever of next to nothing."""
    n, rng = 400, np.random.default_rng(5)
    q = np.tile([0.3, 0.5, 0.0], (n, 1))
    jacobian = body.tip_jacobian(q[0])[:3]
    along = np.cross(jacobian[:, 1], body.joint_axes()[1].axis_world) / np.linalg.norm(jacobian[:, 1])
    along += 1e-6 * jacobian[:, 1] / np.linalg.norm(jacobian[:, 1])
    assert np.abs(jacobian[:, 1:].T @ along).max() < 1e-5
    torque = body.inverse_dynamics_batch(q, 0.0 * q, 0.0 * q) + 5.0 * jacobian.T @ along
    known = {"joint_position": q, "joint_torque": torque + rng.normal(0.0, 0.01, q.shape)}
    known |= {"touching": np.ones(n), "press_direction_world": np.tile(along, (n, 1))}
    pressed = resting(0, 5.0, n)
    data = replace(pressed, time_s=0.001 * np.arange(n), context={**pressed.context, **known})
    assert np.abs(with_rigid_body(data, body, 0).context["force_beyond_reading"]).max() < 0.1


@pytest.mark.parametrize(
    ("dip_rad", "bias_nm", "noise_nm", "named"),
    [
        (0.0, 0.02, 0.02, ["bias"]),  # joint 2 has no such tilt
        (0.0, 0.02, 5.0, ["gravity_tilt"]),  # joint 2 does not show whether it has
        (0.03, 0.0, 0.02, ["gravity_tilt"]),  # joint 2 has the same
    ],
)
def test_tilt_of_one_joint_is_named_unless_another_joint_excludes_it(dip_rad, bias_nm, noise_nm, named):
    """Alone, joint 3 cannot tell a bias from a tilt of the base."""
    second, third = swinging(1, dip_rad, noise_nm=noise_nm), swinging(2, dip_rad, noise_nm=0.01)
    third = replace(third, effort=third.effort + bias_nm)
    effects = [EFFECTS[name]() for name in ("gravity_tilt", "bias")]
    model = Model("rigid_body", (KnownRigidBody(),))
    alone, joints = (
        diagnose(channels, model, effects, rng=np.random.default_rng(0)).channels
        for channels in (third, [second, third])
    )
    assert [each.effect for each in alone[0].accepted] == ["gravity_tilt"]
    assert [each.effect for each in joints[1].accepted] == named


@pytest.mark.parametrize(
    ("change", "excludes"),
    [
        ({}, True),
        ({"accepted": ["bias"]}, False),  # what joint 2 names may stand for the tilt
        ({"accepted": ["gravity_tilt"]}, False),
        ({"complete": False}, False),
    ],
)
def test_only_a_joint_in_which_nothing_is_missing_excludes_a_tilt(change, excludes):
    second, third = swinging(1, 0.0, 0.6, noise_nm=0.02), swinging(2, 0.0, noise_nm=0.01)
    third = replace(third, effort=third.effort + 0.02)
    channels, models = [second, third], [Model("rigid_body", (KnownRigidBody(),))] * 2
    effects = [EFFECTS[name]() for name in ("gravity_tilt", "bias")]
    clean, tilted = (
        diagnose(data, models[0], effects, rng=np.random.default_rng(0)).channels[0] for data in channels
    )
    (tilt,) = tilted.accepted
    if "accepted" in change:
        change = {"accepted": [tilt.model_copy(update={"effect": name}) for name in change["accepted"]]}
    judged = [clean.model_copy(update=change), tilted]
    found = contradicted_effect(tilted, judged, channels, models, effects)
    assert found == ("gravity_tilt" if excludes else None)
    alone = tilted.model_copy(update={"accepted": [tilt.model_copy(update={"confused_with": []})]})
    assert contradicted_effect(alone, judged, channels, models, effects) is None
    unknown = tilted.model_copy(update={"complete": False})
    assert contradicted_effect(unknown, judged, channels, models, effects) is None
