from pathlib import Path

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.diagnosis import Verdict, diagnose
from palpate.estimation.effects import EFFECTS
from palpate.estimation.models import MODELS
from palpate.robot_io.errors import InputError
from tests.estimation.arm.panda import joint_channels

URDF = (Path(__file__).parents[3] / "sim_backend" / "arms" / "follower" / "follower.urdf").read_text()
TIP = "tip"


def arm(seed, extra=lambda body, q, v, a: 0.0, runs=4, count=900):
    """Joint channels of an arm that swings through several runs, with 0.02 N m of noise."""
    rng = np.random.default_rng(seed)
    body, t = RigidBody.from_urdf(URDF, TIP), np.arange(count) * 0.005
    parts = []
    for _ in range(runs):
        f, p = rng.uniform(0.2, 1.5, (3, 3)), rng.uniform(0, 6, (3, 3))
        waves = 2 * np.pi * f * t[:, None, None] + p
        size = 0.25 / f
        w = 2 * np.pi * f
        motion = (size * np.sin(waves), size * w * np.cos(waves), -size * w**2 * np.sin(waves))
        parts.append([signal.sum(2) for signal in motion])
    q, v, a = (np.concatenate([part[i] for part in parts]) for i in range(3))
    torque = np.array([body.inverse_dynamics(*row) for row in zip(q, v, a, strict=True)])
    torque = torque + extra(body, q, v, a) + rng.normal(0, 0.02, torque.shape)
    return joint_channels(np.tile(t, runs), (q, v, a), torque, np.repeat(np.arange(runs), count))


def answer(channels, model, joint, *names):
    """The diagnosis of a joint, in which the effects of these names are tried, or all."""
    context, base = ModelContext(joint, Arm(URDF, TIP)), MODELS[model]()
    data, effects = base.prepare(channels[joint], context), [EFFECTS[name]() for name in names] or None
    return diagnose(data, base.build(context), effects, rng=np.random.default_rng(0)).channels[0]


def weight(body, q, v, a):
    """What 0.4 kg at the tip weigh, from the tip's height alone: the gradient of the potential energy."""
    step, out = 1e-5, np.empty_like(q)
    for j in range(q.shape[1]):
        d = step * np.eye(q.shape[1])[j]
        rise = [body.tip_pose(row + d)[0][2] - body.tip_pose(row - d)[0][2] for row in q]
        out[:, j] = 0.4 * 9.81 * np.array(rise) / (2 * step)
    return out


def test_payload_signal_agrees_with_the_potential_energy_at_rest():
    position = arm(0, count=50)[0].context["joint_position"]
    rest, run = np.zeros_like(position), np.zeros(len(position), dtype=np.int64)
    still = joint_channels(0.005 * np.arange(len(run)), (position, rest, rest), rest, run)
    expected = weight(RigidBody.from_urdf(URDF, TIP), position, None, None) / 0.4
    for joint in range(3):
        ready = MODELS["rigid_body"]().prepare(still[joint], ModelContext(joint, Arm(URDF, TIP)))
        assert ready.context["payload_effort_per_kg"] == pytest.approx(expected[:, joint], abs=1e-5)


def test_urdf_explains_its_own_arm():
    found = answer(arm(1), "rigid_body", 1)
    assert found.verdict is Verdict.ADEQUATE
    assert found.baseline.rmse == pytest.approx(0.02, rel=0.1)


def test_friction_is_identified_with_fitted_arm_parameters():
    channels = arm(2, lambda body, q, v, a: 0.3 * np.tanh(v / 0.01))
    frictions = (f"{name}_friction" for name in ("coulomb", "quadratic", "presliding"))
    tried = (*frictions, "joint_spring", "payload", "bias")
    found = answer(channels, "rigid_body_fitted", 0, *tried)
    assert [entry.effect for entry in found.accepted] == ["coulomb_friction"]
    force = found.accepted[0].parameters["force"]
    assert force.value == pytest.approx(0.3, abs=max(4 * force.std_err, 1e-3))


def test_fitted_base_parameters_predict_the_arm():
    channels = arm(3)
    base, context = MODELS["rigid_body_fitted"](), ModelContext(2, Arm(URDF, TIP))
    model, ready = base.build(context), base.prepare(channels[2], context)
    columns = np.hstack([effect.columns(ready, {}) for effect in model.effects])
    assert np.linalg.matrix_rank(columns) == columns.shape[1]
    gains = np.linalg.lstsq(columns, ready.effort, rcond=None)[0]
    assert np.std(ready.effort - columns @ gains) == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("context", [ModelContext(), ModelContext(0), ModelContext(7, Arm(URDF, TIP))])
def test_rigid_body_names_missing_inputs(context):
    with pytest.raises(InputError, match=r"URDF|arm has 3"):
        MODELS["rigid_body"]().build(context)
