"""PyBullet's arm against Pinocchio's: equal masses, no hidden losses, correct forces."""

import numpy as np
import pinocchio as pin
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.world import ArmDescription
from tests.sim_backend.parts import (
    ARM_NAMES,
    ARMS_DIR,
    SLIDER_URDF,
    column,
    inverse_dynamics,
    make_world,
    scenario,
    shipped_arm,
    watch,
)

FAR_BELOW_M = -5.0


def reference(name):
    model = pin.buildModelFromUrdf(str(ARMS_DIR / name / f"{name}.urdf"))
    return model, model.createData()


@pytest.mark.parametrize("name", ARM_NAMES)
def test_pybullet_agrees_with_the_arm_model_on_inverse_dynamics(name):
    body = RigidBody.from_urdf(ARMS_DIR / name / f"{name}.urdf", "tip")
    world = make_world(shipped_arm(name))
    generator = np.random.default_rng(3)
    for _ in range(200):
        q, qd, qdd = generator.uniform(-1, 1, (3, 3)) * [[np.pi], [8.0], [100.0]]
        ours = inverse_dynamics(world, q, qd, qdd)
        assert np.allclose(ours, body.inverse_dynamics(q, qd, qdd), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ARM_NAMES)
def test_falling_arm_conserves_energy(name):
    model, data = reference(name)
    world = make_world(shipped_arm(name), scenario(surface_m=FAR_BELOW_M))
    world.place([0.3, -0.4, 0.2])
    truths = watch(world, 0.3)  # before a joint meets its stop
    q, qd = column(truths, "joint_position_rad"), column(truths, "joint_velocity_rad_s")
    kinetic = np.array([pin.computeKineticEnergy(model, data, *state) for state in zip(q, qd, strict=True)])
    total = kinetic + np.array([pin.computePotentialEnergy(model, data, angles) for angles in q])
    assert kinetic.max() > 3.0
    assert np.abs(total - total[0]).max() < 1e-3 * kinetic.max()


@pytest.mark.parametrize("name", ARM_NAMES)
def test_static_torques_balance_gravity_and_contact_force(name):
    model, data = reference(name)
    arm = shipped_arm(name)
    q = np.array(arm.home_rad)
    world = make_world(arm)
    force_n = 10.0
    world.object.move_surface(world.truth().tip_position_world_m[2] + force_n / 500.0)
    world.place(q)
    assert world.truth().force_n == pytest.approx(force_n)
    jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId("tip"), pin.LOCAL_WORLD_ALIGNED)
    holding = pin.computeGeneralizedGravity(model, data, q) - force_n * jacobian[2]
    world.set_torque(holding)
    world.advance_to(0.05)
    assert np.abs(world.truth().joint_position_rad - q).max() < 1e-6
    world.set_torque(holding + jacobian[2])  # 1 N less of pressing
    world.advance_to(0.1)
    assert world.truth().tip_position_world_m[2] > 0.1805


def test_tilted_uniaxial_sensor_measures_the_cosine():
    arm = shipped_arm("follower")
    quiet = {"noise_std_n": 0.0, "resolution_n": 0.0}
    tilt = 0.3
    readings = []
    for angle in (0.0, tilt):
        world = make_world(arm, scenario(surface_m=0.2, force=quiet))
        world.place(np.add(arm.home_rad, [0.0, 0.0, angle]))
        world.held = True
        world.advance_to(0.002)
        readings.append(world.force_sensor.read(world.time_s).value[0] / world.truth().force_n)
        world.close()
    assert readings == pytest.approx([1.0, np.cos(tilt)], abs=1e-3)


def test_scaled_arm_needs_scaled_torques_and_drives_are_limited():
    arm = shipped_arm("leader")
    plain, heavy = make_world(arm), make_world(arm, scenario(mass_scale=1.5))
    motion = ([0.2, 0.3, 0.4], [1.0, -2.0, 0.5], [3.0, 2.0, -1.0])
    assert np.allclose(inverse_dynamics(heavy, *motion), 1.5 * inverse_dynamics(plain, *motion))
    world = make_world(shipped_arm("follower"))
    world.set_torque([1000.0, -1000.0, 1.0])
    world.advance_to(0.001)
    assert world.truth().drive_torque_nm.tolist() == [40.0, -40.0, 1.0]


def test_long_fall_exceeds_the_engine_s_default_speed_limit():
    world = make_world(
        ArmDescription(SLIDER_URDF.format(mass_kg=1.0), "probe", (0, 0, -1), (9.9,)),
        scenario(KelvinVoigtLaw(stiffness_n_m=1.0, damping_n_s_m=0.0), surface_m=-50.0, gravity=3000.0),
    )
    world.advance_to(0.08)
    assert world.truth().joint_velocity_rad_s[0] == pytest.approx(-240.0, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tip_frame": "hand_tip"}, "no link 'hand_tip' for tip_frame. Valid: carriage, probe, rail"),
        ({"urdf_text": "not xml"}, "URDF: syntax error"),
        ({"urdf_text": "<robot name='r'><link name='probe'/></robot>"}, "not a serial arm"),
        ({"urdf_text": "<robot><link name='probe'/></robot>"}, "<robot> has no name"),
        ({"urdf_text": SLIDER_URDF.replace('{mass_kg}"', 'heavy"')}, "mass of link 'carriage' is heavy"),
        ({"tip_frame": "rail"}, "joints that do not move the tip: lift"),
        ({"home_rad": (0.0, 0.0)}, r"shape \(2,\), expected \(1,\)"),
    ],
)
def test_unsuitable_robot_is_refused_in_words(change, words, capfd):
    parts = {
        "urdf_text": SLIDER_URDF.format(mass_kg=1.0),
        "tip_frame": "probe",
        "sensor_axis_tip": (0, 0, -1),
        "home_rad": (0.0,),
    }
    with pytest.raises(InputError, match=words):
        make_world(ArmDescription(**(parts | change)))
    assert capfd.readouterr() == ("", "")  # PyBullet's own words stay out of the user's output
