"""Rigid-body dynamics against hand calculation, finite differences and another engine."""

import math
from pathlib import Path

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import load_robot_file
from palpate.sim_backend.scenario import load_scenario
from palpate.sim_backend.world import ArmDescription, World
from tests.control.reference_plant import URDF, test_arm

ARMS = Path(__file__).resolve().parents[2] / "sim_backend" / "arms"
SHIPPED = sorted(path for path in ARMS.glob("*/*.urdf"))
PENDULUM = """
<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>
    <inertia ixx="0.001" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"/>
  <joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
  <joint name="end" type="fixed"><parent link="rod"/><child link="tip"/><origin xyz="0.4 0 0"/></joint>
</robot>
"""


def chain(joints: int) -> str:
    links = "".join(f'<link name="l{i}"/>' for i in range(joints + 1))
    joint = '<joint name="j{0}" type="fixed"><parent link="l{0}"/><child link="l{1}"/></joint>'
    return f'<robot name="r">{links}{"".join(joint.format(i, i + 1) for i in range(joints))}</robot>'


def random_states(count: int = 20):
    return np.random.default_rng(3).uniform(-2.0, 2.0, (count, 3, 3))


def bodies():
    return [test_arm(), *(RigidBody.from_urdf(path, "tip") for path in SHIPPED)]


def test_shipped_arms_are_complete():
    assert len(SHIPPED) >= 2


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, -1.2, math.pi / 2])
def test_pendulum_torque_matches_the_textbook(angle_rad):
    body = RigidBody.from_urdf(PENDULUM, "tip")
    torque = body.inverse_dynamics(np.array([angle_rad]), np.array([2.0]), np.array([3.0]))
    # Positive about +y turns the rod from +x towards -z, so gravity pulls the positive way.
    inertia_about_pivot = 0.02 + 1.5 * 0.2**2
    expected = inertia_about_pivot * 3.0 - 1.5 * 9.81 * 0.2 * math.cos(angle_rad)
    assert torque == pytest.approx([expected], abs=1e-12)


def test_jacobian_matches_finite_differences_of_forward_kinematics():
    step = 1e-6
    for body in bodies():
        for position, _, _ in random_states(5):
            jacobian = body.tip_jacobian(position)
            for joint in range(3):
                nudge = np.eye(3)[joint] * step
                ahead, rotation_ahead = body.tip_pose(position + nudge)
                behind, rotation_behind = body.tip_pose(position - nudge)
                turn = (rotation_ahead @ rotation_behind.T - np.eye(3)) / (2 * step)
                assert jacobian[:3, joint] == pytest.approx((ahead - behind) / (2 * step), abs=1e-8)
                spin = (turn[2, 1], turn[0, 2], turn[1, 0])
                assert jacobian[3:, joint] == pytest.approx(spin, abs=1e-5)


def test_tip_velocity_matches_finite_differences():
    body = test_arm()
    for position, velocity, _ in random_states(5):
        motion = body.tip_motion(position, velocity)
        ahead, _ = body.tip_pose(position + 1e-6 * velocity)
        behind, _ = body.tip_pose(position - 1e-6 * velocity)
        assert motion.velocity_world_m_s == pytest.approx((ahead - behind) / 2e-6, abs=1e-8)


def test_results_are_not_overwritten_by_the_next_call():
    body = test_arm()
    (first, rate, acceleration), (second, *_), *_ = random_states(2)
    calls = (
        lambda q: body.inverse_dynamics(q, rate, acceleration),
        body.tip_jacobian,
        body.mass_matrix,
        body.gravity,
        lambda q: body.forward_dynamics(q, rate, acceleration),
        lambda q: body.regressor(q, rate, acceleration),
        lambda q: body.tip_motion(q, rate).position_world_m,
        lambda q: body.tip_motion(q, rate).rotation_world_tip,
        lambda q: body.tip_motion(q, rate).jacobian_world,
    )
    for call in calls:
        kept = call(first)
        copy = kept.copy()
        call(second)
        assert (kept == copy).all()


def test_inverse_dynamics_is_mass_matrix_and_bias():
    for body in bodies():
        for position, velocity, acceleration in random_states():
            torque = body.inverse_dynamics(position, velocity, acceleration)
            mass, still = body.mass_matrix(position), np.zeros(3)
            bias = body.inverse_dynamics(position, velocity, still)
            assert torque == pytest.approx(mass @ acceleration + bias, abs=1e-10)
            assert body.forward_dynamics(position, velocity, torque) == pytest.approx(acceleration, abs=1e-9)
            assert np.linalg.eigvalsh(mass).min() > 0.0
            assert body.gravity(position) == pytest.approx(
                body.inverse_dynamics(position, still, still), abs=1e-12
            )


def test_gravity_is_the_gradient_of_potential_energy():
    body = test_arm()

    def potential_j(position):
        # Masses and lengths of the reference arm, by hand: each rod's middle above the base, z up.
        heights = -np.sin(np.cumsum(position)) * (0.32, 0.28, 0.12)
        middles = np.cumsum(heights) - heights / 2
        return 9.81 * float(middles @ (1.8, 1.2, 0.5))

    for position, _, _ in random_states(5):
        slope = [
            (potential_j(position + 1e-6 * e) - potential_j(position - 1e-6 * e)) / 2e-6 for e in np.eye(3)
        ]
        assert body.gravity(position) == pytest.approx(slope, abs=1e-7)


def test_regressor_times_parameters_is_inverse_dynamics():
    for body in (*bodies(), RigidBody.from_urdf(PENDULUM, "tip")):
        count = body.joint_count
        for state in random_states(5):
            motion = [values[:count] for values in state]
            matrix = body.regressor(*motion)
            assert matrix.shape == (count, 10 * count)
            assert matrix @ body.parameters == pytest.approx(body.inverse_dynamics(*motion), abs=1e-12)
            rows = body.joint_regressor(count - 1, *(values[None] for values in motion))
            assert np.array_equal(rows, matrix[-1:])


def test_joint_axes_are_where_the_urdf_puts_them():
    axes = test_arm().joint_axes()
    assert [axis.name for axis in axes] == ["joint_1", "joint_2", "joint_3"]
    assert axes[2].origin_world_m == pytest.approx((0.60, 0.0, 0.0), abs=1e-12)
    assert all(axis.axis_world == pytest.approx((0.0, 1.0, 0.0), abs=1e-12) for axis in axes)
    (axis,) = RigidBody.from_urdf(PENDULUM, "tip").joint_axes()
    assert (axis.name, axis.revolute) == ("pivot", True)
    assert axis.origin_world_m == pytest.approx(np.zeros(3), abs=1e-12)
    assert axis.axis_world == pytest.approx((0.0, 1.0, 0.0), abs=1e-12)


@pytest.mark.parametrize(
    ("urdf", "tip", "message"),
    [
        (PENDULUM.replace("revolute", "continuous"), "tip", "'pivot': only revolute"),
        (URDF, "finger", "no frame is called 'finger'. Valid: .*joint_1_link.*tip"),
        ("<robot", "tip", "URDF text: not a readable URDF"),
        ("<table/>", "tip", "its root is <table>"),
        ('<robot name="r"><link name="tip"/></robot>', "tip", "has no movable joint"),
        ("missing.urdf", "tip", "missing.urdf: not a readable URDF .No such file"),
        (PENDULUM.replace("1.5", "-1.5"), "tip", "mass of link 'rod' is -1.5 kg"),
        (PENDULUM.replace("1.5", "nan"), "tip", "mass of link 'rod' is nan kg"),
        (PENDULUM.replace("1.5", "1,5"), "tip", "mass of link 'rod' is 1,5 kg"),
        (PENDULUM.replace("1.5", "much"), "tip", "not a readable URDF .*much"),
        ('<robot name="r"/>', "tip", "No link elements found"),
        (PENDULUM.replace("revolute", "hinge"), "tip", "has no known type .hinge"),
        (PENDULUM.replace('link="rod"', 'link="lost"'), "tip", "lost"),
        (PENDULUM.replace('izz="0.02"', 'izz="nan"'), "tip", "izz='nan'.*not 1 finite"),
        (PENDULUM.replace('iyy="0.02"', 'iyy="0,02"'), "tip", "iyy='0,02'"),
        (PENDULUM.replace('iyy="0.02"', ""), "tip", "inertia of link 'rod' lacks"),
        (PENDULUM.replace('ixy="0"', 'ixy="0.1"'), "tip", "'rod' has a negative moment"),
        (PENDULUM.replace('xyz="0.4 0 0"', 'xyz="0.4 0"'), "tip", "not 3 finite numbers"),
        (PENDULUM.replace('upper="3"', 'upper="inf"'), "tip", "upper='inf'"),
        (chain(501), "tip", "502 links, at most 500"),
        (chain(2).replace('parent link="l0"', 'parent link="l2"'), "tip", "form a loop"),
        (chain(2).replace('child link="l2"', 'child link="l1"'), "tip", "'l1' has two parent joints"),
        ("<robot>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>", "tip", "nested deeper than 20"),
        ("<robot>" + "<a/>" * 30_000 + "</robot>", "tip", "more than 20000 elements"),
        ("<!DOCTYPE r [<!ENTITY a 'b'>]><robot name='&a;'/>", "tip", "document type"),
    ],
)
def test_invalid_urdf_is_one_clear_line(urdf, tip, message, capfd):
    with pytest.raises(InputError, match=message) as caught:
        RigidBody.from_urdf(urdf, tip)
    assert capfd.readouterr() == ("", "")  # also nothing from the C++ parser
    assert "\n" not in str(caught.value)


def test_massless_joint_is_named():
    urdf = PENDULUM
    inertial = urdf[urdf.index("<inertial>") : urdf.index("</inertial>") + len("</inertial>")]
    assert RigidBody.from_urdf(urdf, "tip").weightless_joint == ""
    assert RigidBody.from_urdf(urdf.replace(inertial, ""), "tip").weightless_joint == "pivot"


@pytest.mark.parametrize("count", [1, 20])
def test_many_samples_at_once_equal_single_samples(count):
    for body in (*bodies(), RigidBody.from_urdf(PENDULUM, "tip")):
        motions = np.random.default_rng(3).uniform(-2.0, 2.0, (3, count, len(body.joint_names)))
        one_by_one = [body.inverse_dynamics(*rows) for rows in motions.transpose(1, 0, 2)]
        assert body.inverse_dynamics_batch(*motions) == pytest.approx(np.array(one_by_one), abs=1e-12)


def test_load_equals_a_point_mass_at_the_tip():
    step_s, mass_kg = 1e-5, 0.7
    for body in bodies():
        for position, velocity, acceleration in random_states(5):
            ahead, behind = (
                body.tip_motion(
                    position + s * velocity + 0.5 * s**2 * acceleration, velocity + s * acceleration
                ).velocity_world_m_s
                for s in (step_s, -step_s)
            )
            force = mass_kg * ((ahead - behind) / (2.0 * step_s) + [0.0, 0.0, 9.81])
            loaded = body.with_load(mass_kg).inverse_dynamics(position, velocity, acceleration)
            bare = body.inverse_dynamics(position, velocity, acceleration)
            assert loaded - bare == pytest.approx(body.tip_jacobian(position)[:3].T @ force, abs=1e-6)


def test_torques_are_linear_in_the_gravity_of_any_base():
    for path in SHIPPED:
        body = RigidBody.from_urdf(path, "tip", (1.0, -2.0, -9.0))
        motions = np.swapaxes(random_states(20), 0, 1)[..., : body.joint_count]
        inertial, gravity = body.inertial_and_gravity_torques(*motions)
        for direction in ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (-1.0, 4.0, -8.0)):
            torque = RigidBody.from_urdf(path, "tip", direction).inverse_dynamics_batch(*motions)
            np.testing.assert_allclose(inertial + gravity @ direction, torque, atol=1e-12)


def test_rotors_add_to_joint_inertia_only():
    rotors = (0.03, 0.02, 0.01)
    path = SHIPPED[0]
    bare, geared = (
        RigidBody.from_urdf(path, "tip"),
        RigidBody.from_urdf(path, "tip", rotor_inertia_kg_m2=rotors),
    )
    for position, velocity, acceleration in random_states(5):
        added = geared.inverse_dynamics(position, velocity, acceleration)
        added = added - bare.inverse_dynamics(position, velocity, acceleration)
        np.testing.assert_allclose(added, rotors * acceleration, atol=1e-12)
        np.testing.assert_allclose(geared.mass_matrix(position), bare.mass_matrix(position) + np.diag(rotors))
        np.testing.assert_allclose(geared.gravity(position), bare.gravity(position))
    with pytest.raises(InputError, match="rotor inertia"):
        RigidBody.from_urdf(path, "tip", rotor_inertia_kg_m2=(0.03,))


def test_simulated_arm_and_model_feel_the_rotors_alike():
    """Three rotors ten times as heavy as what the wrist feels of the arm."""
    robot_file = load_robot_file(ARMS.parents[1] / "robots" / "so101.yaml")
    rotors, home = np.array(robot_file.rotor_inertia_kg_m2), np.array(robot_file.home_rad)
    text = robot_file.urdf_path.read_text(encoding="utf-8")
    world = World(
        ArmDescription(text, "tip", robot_file.sensor_axis_tip, home, tuple(rotors)), load_scenario({})
    )
    body = RigidBody.from_urdf(text, "tip", rotor_inertia_kg_m2=rotors)
    world.set_torque(body.gravity(home) + np.array((0.1, -0.05, 0.02)))
    world.advance_to(0.05)
    truth = world.truth()
    world.close()
    push = np.array((0.1, -0.05, 0.02))
    expected = np.linalg.solve(body.mass_matrix(home), push) * 0.05
    np.testing.assert_allclose(truth.joint_velocity_rad_s, expected, rtol=0.05, atol=2e-3)
    without = RigidBody.from_urdf(text, "tip")
    assert np.abs(np.linalg.solve(without.mass_matrix(home), push) * 0.05 - expected).max() > 0.1
