"""Hidden joint, drive and mass effects follow their physics without a controller."""

import numpy as np
import pinocchio
import pytest
from scipy.integrate import solve_ivp

from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.world import World
from tests.sim_backend.hidden_parts import STEP_S, hidden, hidden_slider, let_go, quiet_scenario, steps
from tests.sim_backend.parts import GRAVITY_M_S2, inverse_dynamics, shipped_arm

G = GRAVITY_M_S2
FRICTIONS = {
    "viscous_friction": {"viscous_nms_rad": 3.0},
    "coulomb_friction": {"coulomb_nm": 2.0},
    "stribeck_friction": {"stiction_nm": 1.0, "speed_rad_s": 0.1, "coulomb_nm": 0.5},
    "asymmetric_friction": {"positive_nm": 2.0, "negative_nm": 1.0},
    "load_dependent_friction": {"load_share": 0.2},
    "quadratic_friction": {"quadratic_nms2_rad2": 4.0},
}


def accelerations(world, force, speed, duration_s=0.05):
    """Mean acceleration [m/s^2] of the 1 kg slider under a drive's force, started with a speed."""
    world.set_torque([force])
    _, velocity = let_go(world, duration_s, speed)
    return (velocity[-1] - velocity[0]) / (duration_s - STEP_S)


def test_viscous_and_quadratic_friction_limit_the_fall():
    world = hidden_slider(hidden("viscous_friction", joint=1, viscous_nms_rad=8.0))
    _, velocity = let_go(world, 1.0)
    assert velocity[-1] == pytest.approx(-G / 8.0, rel=1e-3)
    t = steps(1.0)
    assert velocity == pytest.approx(-G / 8.0 * (1 - np.exp(-8.0 * t)), abs=2e-3)
    world = hidden_slider(hidden("quadratic_friction", joint=1, quadratic_nms2_rad2=4.0), height_m=9.0)
    _, velocity = let_go(world, 1.0)
    assert velocity[-1] == pytest.approx(-np.sqrt(G / 4.0), rel=1e-3)
    t = steps(1.0)
    assert velocity == pytest.approx(-np.sqrt(G / 4) * np.tanh(t * np.sqrt(G * 4)), abs=3e-3)


def test_coulomb_friction_brakes_evenly_to_a_stop_and_holds():
    world = hidden_slider(hidden("coulomb_friction", joint=1, coulomb_nm=2.0), gravity=0.0)
    position, velocity = let_go(world, 1.0, speed=1.0)
    t = steps(1.0)
    assert velocity == pytest.approx(np.maximum(1.0 - 2.0 * t, 0.0), abs=1e-3)
    assert np.ptp(position[t > 0.55]) < 1e-6
    for force, expected in ((1.99, 0.0), (-1.99, 0.0), (2.5, 0.5), (-3.0, -1.0)):
        assert accelerations(world, force, 0.0) == pytest.approx(expected, abs=1e-6)


def test_stribeck_friction_breaks_away_and_decreases_with_speed():
    entry = hidden("stribeck_friction", joint=1, stiction_nm=2.0, speed_rad_s=0.2, coulomb_nm=1.0)
    world = hidden_slider(entry, gravity=0.0)
    assert accelerations(world, 2.99, 0.0) == pytest.approx(0.0, abs=1e-6)
    assert accelerations(world, 3.2, 0.0) > 0.2
    world.set_torque([0.0])
    t = steps(0.9)
    _, velocity = let_go(world, 0.9, speed=0.8)

    def braking(_time, v):
        return -(1.0 + 2.0 * np.exp(-((v / 0.2) ** 2)))

    expected = solve_ivp(braking, (0, 0.9), [0.8], t_eval=t, rtol=1e-8).y[0]
    moving = expected > 0.05
    assert velocity[moving] == pytest.approx(expected[moving], abs=2e-3)
    assert velocity[-1] == pytest.approx(0.0, abs=1e-6)


def test_asymmetric_and_load_dependent_friction_follow_their_laws():
    world = hidden_slider(
        hidden("asymmetric_friction", joint=1, positive_nm=3.0, negative_nm=1.0), gravity=0.0
    )
    measured = [accelerations(world, 0.0, speed) for speed in (1.0, -1.0)]
    assert measured == pytest.approx([-3.0, 1.0], abs=1e-6)
    for force, expected in ((2.9, 0.0), (-0.9, 0.0), (3.5, 0.5), (-1.5, -0.5)):
        assert accelerations(world, force, 0.0) == pytest.approx(expected, abs=1e-6)
    # Of 1 kg with an acceleration a the load is a; the drive bears it and 0.2 a, or is helped by 0.2 a.
    world = hidden_slider(hidden("load_dependent_friction", joint=1, load_share=0.2), gravity=0.0)
    for speed, drive_per_load in ((0.0, 1.2), (1.0, 1.2), (-1.0, 0.8)):
        assert drive_per_load * accelerations(world, 5.0, speed) == pytest.approx(5.0)
    assert accelerations(world, 0.0, 1.0) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", sorted(FRICTIONS))
def test_friction_of_any_strength_stops_a_joint_without_reversal(name):
    huge = dict.fromkeys(FRICTIONS[name], 90.0) | {"load_share": 0.9, "speed_rad_s": 0.01}
    parameters = {key: huge[key] for key in FRICTIONS[name]}
    world = World(shipped_arm("follower"), quiet_scenario(hidden(name, joint=3, **parameters)))
    world.place([0.5, -1.0, -0.5], [1.0, -1.0, 2.0])
    wrist = []
    for time_s in steps(0.3):
        world.advance_to(time_s)
        wrist.append(world.truth().joint_velocity_rad_s[2])
    assert np.isfinite(wrist).all()
    if name in {"coulomb_friction", "asymmetric_friction", "stribeck_friction"}:
        assert min(wrist) > -1e-3  # the wrist weighs nothing against 90 N m
        assert wrist[-1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("name", sorted(FRICTIONS))
def test_friction_in_a_falling_arm_only_dissipates(name):
    arm = shipped_arm("follower")
    world = World(arm, quiet_scenario(hidden(name, joint=2, **FRICTIONS[name]), surface_m=-5.0))
    model = pinocchio.buildModelFromXML(arm.urdf_text)
    data = model.createData()
    world.set_torque([2.0, 1.0, 0.1])
    energy, work = [], 0.0
    before = world.truth()
    for time_s in steps(0.4):
        world.advance_to(time_s)
        now = world.truth()
        work += float(now.drive_torque_nm @ (now.joint_position_rad - before.joint_position_rad))
        before = now
        q, v = now.joint_position_rad, now.joint_velocity_rad_s
        total = pinocchio.computeKineticEnergy(model, data, q, v)
        energy.append(total + pinocchio.computePotentialEnergy(model, data, q) - work)
    assert np.diff(energy[::20]).max() < 5e-3
    assert energy[-1] < energy[0] - 0.01


@pytest.mark.parametrize(("joint", "lever_from"), [(3, "tip"), (2, "wrist"), (1, "elbow")])
def test_payload_weighs_at_its_lever_arm_and_adds_its_inertia(joint, lever_from):
    arm, mass = shipped_arm("follower"), 0.4
    plain = World(arm, quiet_scenario())
    loaded = World(arm, quiet_scenario(hidden("payload", joint=joint, mass_kg=mass)))
    q, rest = np.array([0.7, -1.1, -0.4]), np.zeros(3)
    # Places of elbow, wrist and tip in the arm's plane, from the lengths in the URDF.
    angles = np.cumsum(q)
    ends = np.cumsum([0.3, 0.25, 0.16] * np.array([np.cos(angles), np.sin(angles)]), axis=1)
    at = ends[:, {"elbow": 0, "wrist": 1, "tip": 2}[lever_from]]
    starts = np.column_stack([np.zeros(2), ends[:, :2]])[:, :joint]
    jacobian = np.zeros((2, 3))
    jacobian[:, :joint] = np.array([-(at[1] - starts[1]), at[0] - starts[0]])
    weight = inverse_dynamics(loaded, q, rest, rest) - inverse_dynamics(plain, q, rest, rest)
    assert weight == pytest.approx(mass * G * jacobian[1], abs=1e-6)
    for axis in np.eye(3):
        pull = inverse_dynamics(loaded, q, rest, axis) - inverse_dynamics(plain, q, rest, axis) - weight
        assert pull == pytest.approx(mass * jacobian.T @ jacobian @ axis, abs=5e-5 * mass)


def test_two_payloads_add_up():
    arm, rest = shipped_arm("leader"), np.zeros(3)
    q = np.array([0.2, -0.6, -0.3])
    worlds = [
        World(arm, quiet_scenario(*[hidden("payload", joint=j, mass_kg=m) for j, m in entries]))
        for entries in ([(2, 0.1), (2, 0.2)], [(2, 0.3)])
    ]
    both, one = (inverse_dynamics(world, q, rest, rest) for world in worlds)
    assert both == pytest.approx(one, abs=1e-9)


@pytest.mark.parametrize(("mass", "rotor"), [(1.0, 0.5), (1.0, 10.0), (0.05, 10.0)])
def test_rotor_is_as_heavy_as_a_mass_for_its_own_joint(mass, rotor):
    world = hidden_slider(hidden("armature", joint=1, inertia_kg_m2=rotor), mass_kg=mass)
    world.set_torque([3.0])
    _, velocity = let_go(world, 0.2)
    expected = (3.0 - mass * G) / (mass + rotor)  # its weight is not the rotor's
    assert (velocity[-1] - velocity[1]) / (0.2 - 2 * STEP_S) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("inertia", [[0, 0, 0], [0.1, 0.2, 0.02]])
def test_arm_with_rotors_moves_with_them_on_the_inertia_diagonal(inertia):
    arm, rate_hz = shipped_arm("follower"), 16_000.0  # the engine is of the first order in the step
    entries = [hidden("armature", joint=j + 1, inertia_kg_m2=J) for j, J in enumerate(inertia) if J]
    world = World(arm, quiet_scenario(*entries, surface_m=-5.0, rate_hz=rate_hz))
    model = pinocchio.buildModelFromXML(arm.urdf_text)
    model.armature = np.array(inertia, dtype=float)
    data = model.createData()
    torque = np.array([3.0, 1.0, 0.05])

    def motion(_time, state):
        return np.concatenate([state[3:], pinocchio.aba(model, data, state[:3], state[3:], torque)])

    start = np.array([0.6, -1.2, -0.5, 0.5, -1.0, 2.0])
    t = np.arange(1, 301) * 1e-3
    expected = solve_ivp(motion, (0, 0.3), start, t_eval=t, rtol=1e-9).y[:3].T
    world.place(start[:3], start[3:] - 0.5 / rate_hz * motion(0.0, start)[3:])
    world.set_torque(torque)
    measured = []
    for time_s in t:
        world.advance_to(time_s)
        measured.append(world.truth().joint_position_rad)
    assert np.abs(np.array(measured) - expected).max() < 2.5e-3
    assert np.abs(expected[-1] - start[:3]).max() > 0.2


def test_rotor_much_heavier_than_the_wrist_conserves_energy():
    arm, rotor = shipped_arm("follower"), 1.0
    world = World(
        arm, quiet_scenario(hidden("armature", joint=3, inertia_kg_m2=rotor), gravity=0.0, surface_m=-5.0)
    )
    world.place([0.6, -1.2, -0.5], [0.6, -1.0, 1.5])
    model = pinocchio.buildModelFromXML(arm.urdf_text)
    data, energy = model.createData(), []
    for time_s in steps(0.6):
        world.advance_to(time_s)
        q, v = world.truth().joint_position_rad, world.truth().joint_velocity_rad_s
        energy.append(pinocchio.computeKineticEnergy(model, data, q, v) + 0.5 * rotor * v[2] ** 2)
    assert np.ptp(energy) < 0.02 * energy[0]


def test_heavy_rotor_is_stable_on_a_stiff_and_damped_object():
    law = KelvinVoigtLaw(stiffness_n_m=1e4, damping_n_s_m=200.0)
    rotor = hidden("armature", joint=1, inertia_kg_m2=10.0)
    position, _ = let_go(hidden_slider(rotor, height_m=0.01, mass_kg=0.5, law=law), 1.5)
    assert position.max() <= 0.01
    assert position[-1] == pytest.approx(-0.5 * G / 1e4, abs=2e-4)


@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (-0.3, 0.0), (0.2, 0.4), (0.0, 0.5)])
def test_tilted_base_changes_the_gravity_direction(pitch, roll):
    arm, q, rest = shipped_arm("follower"), np.array([0.4, -0.8, -0.6]), np.zeros(3)
    world = World(arm, quiet_scenario(hidden("gravity_tilt", pitch_rad=pitch, roll_rad=roll)))
    model = pinocchio.buildModelFromXML(arm.urdf_text)
    turned = pinocchio.utils.rotate("y", pitch) @ pinocchio.utils.rotate("x", roll)
    model.gravity.linear = turned.T @ [0.0, 0.0, -G]
    expected = pinocchio.rnea(model, model.createData(), q, rest, rest)
    assert inverse_dynamics(world, q, rest, rest) == pytest.approx(expected, abs=1e-5)


def test_base_that_dips_forward_lets_the_arm_fall_forward():
    world = World(shipped_arm("follower"), quiet_scenario(hidden("gravity_tilt", pitch_rad=0.3)))
    holding = inverse_dynamics(world, np.array([np.pi / 2, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    assert holding[0] > 1.0  # positive lifts, as the arm now leans towards +x


def test_ripple_is_converted_to_speed_and_back():
    entry = hidden("torque_ripple", joint=1, amplitude_nm=2.0, cycles=20.0, phase_rad=0.3)
    position, velocity = let_go(hidden_slider(entry, gravity=0.0, height_m=0.5), 1.0, speed=1.0)
    potential = 2.0 / 20.0 * np.cos(20.0 * position + 0.3)  # minus its slope is the ripple's force
    midway = 0.5 * (velocity[1:] + velocity[:-1])  # the engine's speed is that of half a step before
    energy = 0.5 * midway**2 + potential[:-1]
    assert np.ptp(potential) == pytest.approx(0.2, rel=1e-3)
    assert np.ptp(energy) < 2e-3


def test_joint_spring_oscillates_about_its_rest():
    world = hidden_slider(hidden("joint_spring", joint=1, stiffness_nm_rad=40.0, rest_rad=5.0), gravity=0.0)
    position, _ = let_go(world, 1.0, speed=0.5)
    omega, t = np.sqrt(40.0), steps(1.0)
    assert position - 5.0 == pytest.approx(0.5 / omega * np.sin(omega * t), abs=2e-4)


def test_wrong_motor_constant_exerts_more_than_reported():
    world = hidden_slider(hidden("torque_gain", joint=1, gain=1.3), gravity=0.0)
    assert accelerations(world, 2.0, 0.0) == pytest.approx(2.6)
    assert world.torque_sensor.read(world.time_s).value == pytest.approx([2.0])


def lead(world, force, times_s):
    """What the encoder says beyond the true position, in steps under a drive's force."""
    start_s, ahead = world.time_s, []
    world.set_torque([force])
    for time_s in times_s:
        world.advance_to(start_s + time_s)
        sample = world.encoder.read(world.time_s)
        ahead.append(sample.value[0] - world.truth().joint_position_rad[0])
    return np.array(ahead)


def test_play_is_crossed_on_torque_reversal_and_shows_in_the_encoder_only():
    world = hidden_slider(
        hidden("backlash", joint=1, gap_rad=2e-3, film_nms_rad=10.0), gravity=0.0, height_m=5.0
    )
    every_other = steps(0.1)[1::2]  # the encoder samples at half the physics rate
    assert lead(world, 1.0, every_other)[-1] == pytest.approx(1e-3, abs=1e-9)
    across = lead(world, -0.5, every_other)
    crossing_s = 2e-3 * 10.0 / 0.5
    assert across == pytest.approx(np.maximum(1e-3 - 2e-3 * every_other / crossing_s, -1e-3), abs=1e-9)
    assert world.truth().joint_velocity_rad_s[0] == pytest.approx(0.1 - 0.05)  # the link feels all of it


def test_shaft_twists_by_the_carried_torque_in_its_time():
    entry = hidden("joint_elasticity", joint=1, compliance_rad_nm=1e-3, retardation_s=0.02)
    world = hidden_slider(entry, gravity=0.0)
    every_other = steps(0.1)[1::2]
    twist = lead(world, 4.0, every_other)
    assert twist == pytest.approx(4e-3 * (1 - np.exp(-every_other / 0.02)), abs=1e-8)
    world.place([5.0])
    assert lead(world, 4.0, [STEP_S * 2])[0] < 2e-4  # put elsewhere, it begins anew


def test_effects_in_one_joint_leave_the_others_unchanged():
    arm = shipped_arm("follower")
    world = World(arm, quiet_scenario(hidden("joint_elasticity", joint=2, compliance_rad_nm=1e-3)))
    world.set_torque([1.0, 2.0, 0.1])
    world.advance_to(0.05)
    ahead = np.array(world.encoder.read(world.time_s).value[:3]) - world.truth().joint_position_rad
    assert ahead[[0, 2]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert ahead[1] > 1e-3
