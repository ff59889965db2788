"""Joint channels of one arm: one set of base parameters, fitted to all joint torques."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from palpate.estimation.arm.inertial_parameters import base_parameters
from palpate.estimation.base_model import Arm, ModelContext
from palpate.estimation.data_quality import usable
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.shared_gains import with_shared_gains
from tests.estimation.arm.panda import (
    JOINTS,
    TIP,
    joint_channels,
    motion,
    other_bodies,
    panda,
    panda_urdf,
    regressor,
)

BRIEF = {"runs": 2, "seconds": 1.0}
COULOMB = (0.4, 0.0, 0.8, 0.0, 0.3, 0.0, 0.2)  # [N m]: friction in some joints only


def arm_channels(bodies, *, seed=0, noise=0.05, coulomb=COULOMB, moving=range(JOINTS), **of_motion):
    """Joints of an arm with other masses than its URDF's, with dry friction, and noise [N m]."""
    rng = np.random.default_rng(seed)
    (q, v, a), run = motion(rng, moving=moving, **{"runs": 4, "seconds": 5.0, **of_motion})
    torque = regressor(panda(), q, v, a) @ bodies + coulomb * np.sign(v) + rng.normal(0, noise, q.shape)
    return joint_channels(0.01 * np.arange(len(q)), (q, v, a), torque, run)


def fitted_models():
    base, urdf = MODELS["rigid_body_fitted"](), panda_urdf()
    return [base.build(ModelContext(j, Arm(urdf, TIP))) for j in range(JOINTS)]


def prepared(channels):
    base, urdf = MODELS["rigid_body_fitted"](), panda_urdf()
    return [base.prepare(c, ModelContext(j, Arm(urdf, TIP))) for j, c in enumerate(channels)]


def fits(channels, models):
    return [fit_model(data, model, {}, usable(data)) for data, model in zip(channels, models, strict=True)]


def test_all_joints_name_the_same_parameters():
    """A joint's columns times the arm's base parameters, by name, are its torque."""
    body = panda()
    base = base_parameters(body)
    value = dict(zip(base.names, base.grouping @ body.parameters, strict=True))
    channels = prepared(arm_channels(body.parameters, coulomb=(0.0,) * JOINTS, noise=0.0, **BRIEF))
    for joint, model in enumerate(fitted_models()):
        effect = model.effects[0]
        found = effect.columns(channels[joint], {}) @ [value[gain.name] for gain in effect.gains]
        np.testing.assert_allclose(found, channels[joint].effort, atol=1e-8)


@pytest.fixture(scope="module")
def bodies():
    return other_bodies(np.random.default_rng(11), panda().parameters)


@pytest.fixture(scope="module")
def together(bodies):
    channels = prepared(arm_channels(bodies))
    models = [model.with_effect(EFFECTS["coulomb_friction"]()) for model in fitted_models()]
    return fits(with_shared_gains(channels, models), models)


def test_joints_share_base_parameters_and_identify_friction_and_noise(together):
    """Each joint's fit, with what the others say, is the fit of all: they agree on what they share."""
    found = [fitted.solution.parameters for fitted in together]
    for name in found[0]:
        if name.startswith("rigid_body_fitted."):
            values = [one[name] for one in found if name in one]
            np.testing.assert_allclose(values, values[0], rtol=0.02, atol=0.02)
    found = [fitted.solution.parameters["coulomb_friction.force"] for fitted in together]
    np.testing.assert_allclose(found, COULOMB, atol=0.03)
    np.testing.assert_allclose([fitted.rmse for fitted in together], 0.05, rtol=0.15)


def test_unmodeled_friction_does_not_bias_shared_information(bodies):
    friction, offset = (1.5, 2.0, 1.5, 1.0, 0.5, 0.5, 0.5), (0.0, 1.0, -1.0, 0.0, 0.5, 0.0, 0.0)
    channels = arm_channels(bodies, seed=3, coulomb=friction, runs=3, seconds=2.0)
    channels = [replace(data, effort=data.effort + offset[j]) for j, data in enumerate(channels)]
    shared = with_shared_gains(prepared(channels), fitted_models())
    beside = EFFECTS["coulomb_friction"](), EFFECTS["bias"]()
    found = fits(shared, [reduce(Model.with_effect, beside, model) for model in fitted_models()])
    forces = [fitted.solution.parameters["coulomb_friction.force"] for fitted in found]
    np.testing.assert_allclose(forces, friction, atol=0.1)
    np.testing.assert_allclose([fitted.rmse for fitted in found], 0.05, rtol=0.3)


def test_unmodeled_rotors_do_not_bias_shared_information(bodies):
    """A rotor's inertia acts on its own joint alone, unlike that of a link."""
    rotor, models = (0.0, 0.5, 0.0, 0.3, 0.0, 0.05, 0.0), fitted_models()
    channels = arm_channels(bodies, seed=3, coulomb=(0.0,) * JOINTS, runs=3, seconds=2.0)
    channels = [
        replace(data, effort=data.effort + rotor[j] * data.acceleration) for j, data in enumerate(channels)
    ]
    shared = with_shared_gains(prepared(channels), models)
    found = [
        model.with_effect(EFFECTS["armature"]()) if rotor[j] else model for j, model in enumerate(models)
    ]
    np.testing.assert_allclose([fitted.rmse for fitted in fits(shared, found)], 0.05, rtol=0.15)


def test_unexcited_parameters_stay_near_the_urdf(bodies):
    """Two joints that move a little must predict another, full motion better than the URDF does."""
    still = (0.0,) * JOINTS
    little, models = prepared(arm_channels(bodies, moving=(1, 3), size=0.4, coulomb=still)), fitted_models()
    full = prepared(arm_channels(bodies, seed=5, coulomb=still))
    base = base_parameters(panda())
    known = dict(zip(base.names, base.grouping @ panda().parameters, strict=True))
    shared = with_shared_gains(little, models)
    for joint in (1, 3):
        (fitted,) = fits([shared[joint]], [models[joint]])
        urdf = {f"rigid_body_fitted.{name}": value for name, value in known.items()}
        errors = [
            np.sqrt(np.mean((full[joint].effort - models[joint].predict(full[joint], parameters)) ** 2))
            for parameters in (fitted.solution.parameters, {**urdf, "viscous_friction.d": 0.0})
        ]
        assert errors[0] < 0.5 * errors[1]


def test_resting_joints_are_left_unchanged(bodies):
    little = prepared(arm_channels(bodies, moving=(1, 3), **BRIEF))
    shared = with_shared_gains(little, fitted_models())
    assert [data.shared is not None for data in shared] == [j in (1, 3) for j in range(JOINTS)]


def test_diagnoses_of_other_joints_are_preserved(bodies):
    models = fitted_models()
    all_of_them = with_shared_gains(prepared(arm_channels(bodies, **BRIEF)), models)
    (alone,) = with_shared_gains(all_of_them[4:5], models[4:5])
    assert alone.shared is all_of_them[4].shared
