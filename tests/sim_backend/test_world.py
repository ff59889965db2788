"""Simulated world: changing objects, engine contact, independent worlds, hidden effects."""

import gc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.contact_laws.standard import EngineContact, HuntCrossleyLaw, KelvinVoigtLaw
from palpate.sim_backend.hooks import ContactEffect, HiddenEffects, JointEffect, SensorHook
from palpate.sim_backend.world import ArmDescription, world_of
from tests.sim_backend.parts import (
    ARMS_DIR,
    GRAVITY_M_S2,
    SLIDER_URDF,
    column,
    inverse_dynamics,
    make_world,
    scenario,
    shipped_arm,
    slider,
    watch,
)

WEIGHT_N = GRAVITY_M_S2  # of the slider's 1 kg
# MuJoCo has none that is a spring
OWN_CONTACT = pytest.mark.parametrize("engine", ["pybullet"], indirect=True)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"<robot name='a'><link name='b'></robot>", "URDF: mismatched tag"),
        (b"\xff<robot/>", "not UTF-8 text"),
    ],
)
def test_unreadable_urdf_is_named_with_its_robot_file(content, words, tmp_path):
    robot_file = load_robot_file(ARMS_DIR / "follower" / "follower.yaml")
    (tmp_path / "broken.urdf").write_bytes(content)
    robot_file = robot_file.model_copy(update={"urdf": str(tmp_path / "broken.urdf")})
    with pytest.raises(InputError, match=rf"follower.yaml with .*broken.urdf: {words}"):
        world_of(robot_file, scenario())


def settled_depth(world, duration_s=1.0):
    world.advance_to(world.time_s + duration_s)
    assert abs(world.truth().rate_m_s) < 1e-4
    return world.truth().depth_m


def test_object_can_change_while_it_is_touched():
    world = make_world(slider(-0.01), scenario(KelvinVoigtLaw(stiffness_n_m=500, damping_n_s_m=40)))
    assert settled_depth(world) == pytest.approx(WEIGHT_N / 500, rel=1e-3)
    world.object.set_law(KelvinVoigtLaw(stiffness_n_m=2000, damping_n_s_m=80))
    assert settled_depth(world) == pytest.approx(WEIGHT_N / 2000, rel=1e-3)
    world.object.set_law(HuntCrossleyLaw(stiffness=5000, damping=8000, exponent=1.3))
    assert settled_depth(world) == pytest.approx((WEIGHT_N / 5000) ** (1 / 1.3), rel=1e-3)
    before = world.truth().tip_position_world_m[2]
    world.object.move_surface(0.05)
    settled_depth(world, 2.0)
    assert world.truth().tip_position_world_m[2] - before == pytest.approx(0.05, rel=1e-3)


@OWN_CONTACT
@pytest.mark.parametrize("stiffness", [200.0, 500.0, 7000.0])
def test_engine_contact_carries_a_weight_at_the_depth_of_its_spring(stiffness):
    damping = np.sqrt(stiffness)
    world = make_world(slider(0.002), scenario(EngineContact(stiffness_n_m=stiffness, damping_n_s_m=damping)))
    assert settled_depth(world, 2.0) == pytest.approx(WEIGHT_N / stiffness, rel=0.01)
    assert world.truth().force_n == pytest.approx(WEIGHT_N, rel=0.01)


@OWN_CONTACT
def test_engine_contact_pushes_the_probe_at_the_tip_frame():
    arm = shipped_arm("follower")
    world = make_world(arm, scenario(EngineContact(stiffness_n_m=1000, damping_n_s_m=60)))
    tip_m = world.truth().tip_position_world_m
    world.object.move_surface(tip_m[2] + 0.004)
    lever_m = [tip_m[0] - x for x in (0.0, 0.3 * np.cos(arm.home_rad[0]), tip_m[0])]
    world.set_torque(inverse_dynamics(world, arm.home_rad, [0.0] * 3, [0.0] * 3) - 4.0 * np.array(lever_m))
    world.advance_to(0.1)
    assert world.truth().force_n == pytest.approx(4.0, rel=0.02)
    assert world.truth().depth_m == pytest.approx(0.004, rel=0.02)


@OWN_CONTACT
def test_engine_contact_is_at_the_origin_of_a_shifted_and_turned_tip_frame():
    rpy = (0.4, -0.7, 0.3)
    down = Rotation.from_euler("xyz", rpy).inv().apply((0.0, 0.0, -1.0))
    origin = '<origin xyz="0.02 -0.03 -0.05" rpy="{} {} {}"/></joint>\n</robot>'.format(*rpy)
    urdf = SLIDER_URDF.format(mass_kg=1.0).replace("</joint>\n</robot>", origin)
    law = EngineContact(stiffness_n_m=500, damping_n_s_m=22)
    world = make_world(ArmDescription(urdf, "probe", tuple(down), (0.052,)), scenario(law))
    assert settled_depth(world, 2.0) == pytest.approx(WEIGHT_N / 500, rel=0.01)


@OWN_CONTACT
def test_law_and_engine_contact_replace_each_other():
    world = make_world(slider(0.001), scenario(EngineContact(stiffness_n_m=500, damping_n_s_m=40)))
    engine = settled_depth(world)
    world.object.set_law(KelvinVoigtLaw(stiffness_n_m=500, damping_n_s_m=40))
    assert settled_depth(world) == pytest.approx(engine, rel=0.01)
    world.object.set_law(EngineContact(stiffness_n_m=1000, damping_n_s_m=40))
    assert settled_depth(world) == pytest.approx(WEIGHT_N / 1000, rel=0.01)


@pytest.mark.parametrize("engine", ["mujoco"], indirect=True)
def test_engine_without_contact_refuses_the_law_and_keeps_the_object():
    own, spring = (
        EngineContact(stiffness_n_m=500, damping_n_s_m=40),
        KelvinVoigtLaw(stiffness_n_m=500, damping_n_s_m=40),
    )
    with pytest.raises(InputError, match="engine 'mujoco' has none: use 'kelvin_voigt'"):
        make_world(slider(), scenario(own))
    world = make_world(slider(), scenario(spring))
    with pytest.raises(InputError, match="engine 'mujoco' has none"):
        world.object.set_law(own)
    assert world.object.law == spring


def test_worlds_side_by_side_do_not_disturb_each_other():
    def build(stiffness):
        return make_world(slider(0.01), scenario(KelvinVoigtLaw(stiffness_n_m=stiffness, damping_n_s_m=5)))

    expected = column(watch(build(500), 0.3), "depth_m")
    first, second = build(500), build(3000)
    depths = []
    for tick in range(301):
        first.advance_to(tick * 1e-3)
        second.advance_to(tick * 1e-3 * 0.7)
        depths.append(first.truth().depth_m)
        if tick == 150:
            second.object.set_law(KelvinVoigtLaw(stiffness_n_m=100, damping_n_s_m=1))
    first.advance_to(0.4)
    assert np.array_equal(depths, expected)


def test_time_advances_in_whole_steps_and_never_back():
    world = make_world(slider(), start_s=100.0)
    assert world.time_s == 100.0
    for target, reached in ((100.0004, 100.00025), (99.0, 100.00025), (100.001, 100.001)):
        world.advance_to(target)
        assert world.time_s == pytest.approx(reached, abs=1e-12)
    world.advance_to(101.0)
    assert world.time_s == pytest.approx(101.0, abs=1e-9)


def test_held_arm_rests_while_time_and_sensors_advance():
    world = make_world(shipped_arm("leader"))
    world.held = True
    world.advance_to(0.1)
    assert np.array_equal(world.truth().joint_position_rad, shipped_arm("leader").home_rad)
    assert world.encoder.read(world.time_s).sampled_at_s == pytest.approx(0.1)
    world.held = False
    world.advance_to(0.2)
    assert not np.allclose(world.truth().joint_position_rad, shipped_arm("leader").home_rad, atol=1e-2)


@pytest.mark.parametrize("torque", [[np.nan, 0, 0], [1.0, 2.0], [np.inf, 0, 0]])
def test_meaningless_torque_is_refused(torque):
    world = make_world(shipped_arm("leader"))
    with pytest.raises(InputError, match="joint torque"):
        world.set_torque(torque)


def test_closing_twice_is_harmless():
    world = make_world(slider())
    world.close()
    world.close()


class Glue(ContactEffect):
    """Pulls with 2 N within a millimetre above the surface, and remembers when."""

    def __init__(self):
        self.times_s = []

    def contact_force_n(self, state, force_n):
        self.times_s.append(state.time_s)
        return force_n - 2.0 if -1e-3 < state.depth_m <= 0 else force_n


class Drag(JointEffect):
    def joint_torque_nm(self, state, torque_nm):
        return [t - 3.0 * v for t, v in zip(torque_nm, state.velocity_rad_s, strict=True)]


class ConstantOffset(SensorHook):
    def __init__(self, amount):
        self.amount = amount

    def measure(self, time_s, value):
        return [entry + self.amount for entry in value]


def test_contact_effect_acts_on_the_tip_once_a_step():
    glue = Glue()
    world = make_world(slider(0.0005), scenario(gravity=0.0), HiddenEffects(contact=(glue,)))
    assert world.truth().force_n == -2.0
    world.advance_to(0.01)
    assert world.truth().tip_position_world_m[2] < 0.00045
    assert np.diff(glue.times_s) == pytest.approx(0.25e-3)


@OWN_CONTACT
def test_contact_effect_adds_to_the_engine_contact_too():
    class Doubled(ContactEffect):
        def contact_force_n(self, state, force_n):
            return 2 * force_n

    law = EngineContact(stiffness_n_m=500, damping_n_s_m=40)
    world = make_world(slider(0.001), scenario(law), HiddenEffects(contact=(Doubled(),)))
    assert settled_depth(world) == pytest.approx(WEIGHT_N / 1000, rel=0.02)


def test_joint_effect_acts_on_the_links_and_is_invisible_to_the_drives():
    world = make_world(
        slider(5.0), scenario(surface_m=-9.0, torque={"noise_std_nm": 0.0}), HiddenEffects(joint=(Drag(),))
    )
    world.advance_to(2.0)
    assert world.truth().joint_velocity_rad_s[0] == pytest.approx(-GRAVITY_M_S2 / 3.0, rel=0.01)
    assert world.torque_sensor.read(world.time_s).value == [0.0]


def test_sensor_effects_act_on_their_own_sensor():
    hidden = HiddenEffects(
        force=(ConstantOffset(1.0), ConstantOffset(0.5)),
        torque=(ConstantOffset(2.0),),
        encoder=(ConstantOffset(0.25),),
    )
    quiet = {
        "force": {"noise_std_n": 0.0},
        "torque": {"noise_std_nm": 0.0},
        "encoder": {"counts_per_revolution": 1e9},
    }
    world = make_world(slider(0.1), scenario(**quiet), hidden)
    assert world.force_sensor.read(0.0).value == [1.5]
    assert world.torque_sensor.read(0.0).value == [2.0]
    assert world.encoder.read(0.0).value == pytest.approx([0.35, 0.0], abs=1e-8)
    assert world.truth().joint_position_rad[0] == 0.1


@OWN_CONTACT
def test_unreferenced_world_releases_its_engine():
    bullet = pytest.importorskip("pybullet")
    world = make_world(slider(0.1), scenario(engine="pybullet"))
    client = world._engine._client
    assert bullet.isConnected(client)
    del world
    gc.collect()
    assert not bullet.isConnected(client)
