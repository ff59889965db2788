"""Comparison of joint torques and force sensor: a dead sensor is detected, a working one never reported."""

from contextlib import closing

import numpy as np
import pytest

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import DisturbanceObserverGains, Gains
from palpate.control.probing.plan import ProbingPlan
from palpate.robot_io.errors import SafetyTripError
from palpate.robot_io.types import Reading, Status
from tests.control.probing_runs import TICK_S, plant_above, probing_task, run_probing
from tests.control.simulated_arms import SimulatedArm, kelvin_voigt

LIMIT_N = 10.0  # of the plan
NOISY = {"sensors": {"force": {"noise_std_n": 0.1}}}


def freeze(arm: SimulatedArm, value_n: float) -> None:
    """Samples go on arriving in time, and all say the same."""
    sensor = arm.robot.force
    alive = sensor.read_force
    sensor.read_force = lambda: Reading(np.array([value_n]), alive().sampled_at_s, Status.OK)


@pytest.mark.parametrize(
    ("name", "stiffness", "speed_m_s"), [("follower", 7100.0, 0.05), ("leader", 500.0, 0.15)]
)
def test_constant_force_with_fresh_stamps_is_detected_before_twice_the_limit(name, stiffness, speed_m_s):
    plan = ProbingPlan(speeds_m_s=(speed_m_s,))
    arm = SimulatedArm(name, plan, kelvin_voigt(stiffness), lower_time_s=0.2)
    freeze(arm, 0.01)
    with closing(arm.robot):
        result = arm.run()
    assert "joint torques indicate about" in result.cause
    assert "but the force sensor reads 0.0 N; does the sensor work" in result.cause
    tripped_s = arm.guard.tripped.time_s
    time_s, _, force_n, _ = arm.truth.T
    assert force_n[time_s <= tripped_s].max() < 1.4 * LIMIT_N
    assert force_n[(time_s > tripped_s) & (time_s < tripped_s + 0.3)].max() < 1.5 * LIMIT_N


def test_reversed_sensor_is_detected_at_a_third_of_the_force_limit():
    """It says that the object pulls the tool in, while the joints push."""
    arm = SimulatedArm("follower", ProbingPlan(speeds_m_s=(0.1,)), kelvin_voigt(1000.0), lower_time_s=0.2)
    sensor = arm.robot.force
    honest = sensor.read_force
    sensor.read_force = lambda: honest()._replace(value=-honest().value)
    with closing(arm.robot):
        result = arm.run()
    assert "joint torques indicate about" in result.cause
    assert "but the force sensor reads -" in result.cause
    time_s, _, force_n, _ = arm.truth.T
    assert force_n[time_s <= arm.guard.tripped.time_s].max() < 0.35 * LIMIT_N


ADHESION = [{"effect": "adhesion", "pull_off_n": 5.0, "neck_m": 3e-3}]
FRICTION = [
    {"effect": f"{kind}_friction", "joint": joint, name: 1.0}
    for kind, name in (("coulomb", "coulomb_nm"), ("viscous", "viscous_nms_rad"))
    for joint in (1, 2)
]
LOAD = [{"effect": "load_dependent_friction", "joint": joint, "load_share": 0.2} for joint in (1, 2)]
NEAR = kelvin_voigt(10_000.0, 0.0, surface_m=0.16)
LOAD += [{"effect": "payload", "joint": 3, "mass_kg": 0.5}]


@pytest.mark.parametrize(
    ("name", "scenario", "speed_m_s", "least_n"),
    [
        ("follower", kelvin_voigt(1000.0) | NOISY | {"hidden": ADHESION}, 0.15, (-6.0, -4.5)),  # it does pull
        ("follower", kelvin_voigt(500.0, 200.0) | NOISY | {"arm": {"mass_scale": 0.8}}, 0.15, (-1.0, 0.0)),
        ("leader", NEAR | NOISY | {"arm": {"mass_scale": 1.2}}, 0.05, (-1.0, 0.0)),
        ("follower", kelvin_voigt(2000.0) | {"hidden": FRICTION}, 0.15, (-1.0, 0.0)),
        ("follower", kelvin_voigt(2000.0) | {"hidden": LOAD}, 0.15, (-1.0, 0.0)),
    ],
    ids=["adhesion", "lighter and noisy", "heavier and noisy", "friction", "load"],
)
def test_sound_sensor_on_an_unusual_arm_or_object_is_not_reported(name, scenario, speed_m_s, least_n):
    arm = SimulatedArm(name, ProbingPlan(speeds_m_s=(speed_m_s,), hold_s=0.1), scenario)
    with closing(arm.robot):
        arm.run().raise_for_trip()
    assert arm.task.failures == ()
    assert least_n[0] <= arm.truth[:, 2].min() <= least_n[1]


class TestOnTheReferencePlant:
    """The plant that shares nothing with the simulator."""

    def run(self, gains=None, change=lambda plant, measurement: measurement, **plan):
        plant = plant_above(stiffness_n_m=2000.0)
        truth = plant.measure
        plant.measure = lambda: change(plant, truth())
        task = probing_task(ProbingPlan(**({"speeds_m_s": (0.1,), "hold_s": 0.5} | plan)), gains)
        return plant, run_probing(plant, task)

    def test_sensor_frozen_during_hold_is_detected_when_the_object_is_removed(self):
        def stick(plant, measurement):
            if plant.time_s < 1.3:
                return measurement
            plant.surface_height_m -= 0.04 * TICK_S  # slowly, while the sensor says that all is well
            return measurement._replace(force_n=9.9)

        with pytest.raises(SafetyTripError, match=r"about -?[0-2]\.\d N, but the force sensor reads 9.9 N"):
            self.run(change=stick, hold_s=3.0)

    def test_sensor_with_half_the_gain_is_detected(self):
        with pytest.raises(SafetyTripError, match="joint torques indicate about"):
            self.run(change=lambda plant, measured: measured._replace(force_n=0.3 * measured.force_n))

    def test_pid_residual_torque_does_not_trip_the_force_check(self):
        contact = Gains().contact.model_copy(update={"force_feedforward": 0.0})
        _, record = self.run(
            Gains(contact=contact, disturbance_observer=DisturbanceObserverGains(share=0.1, floor_n=2.5))
        )
        assert record.kinds()[-1] == "probing_done"

    def test_late_tick_is_no_contradiction(self):
        """30 ms without a command leave the arm off its motion; it comes back, and is not accused."""
        plant = plant_above(stiffness_n_m=500.0)
        task = probing_task(ProbingPlan(speeds_m_s=(0.15,), hold_s=0.3))
        task.start(plant.measure())
        done, dt_s, ticks = False, TICK_S, 0
        while not done:
            output = task.step(plant.measure(), dt_s)
            done, ticks = output.done, ticks + 1
            dt_s = 0.03 if ticks % 200 == 0 else TICK_S
            plant.advance(output.command.joint_torque_nm, dt_s)
        assert task.failures == ()

    def test_threshold_is_read_from_the_robot_file(self):
        with pytest.raises(SafetyTripError, match="joint torques indicate"):
            self.run(Gains(disturbance_observer=DisturbanceObserverGains(share=0.0, floor_n=0.05)))


def test_effective_tip_mass_is_that_of_the_mass_matrix():
    body: RigidBody = plant_above().body
    position = np.array([0.7, -1.4, 0.3])
    lever_m = np.array([0.0, 0.6, 0.8]) @ body.tip_jacobian(position)[:3]
    pushed = np.linalg.solve(body.mass_matrix(position), lever_m)
    assert body.effective_mass(position, lever_m) == pytest.approx(1.0 / (lever_m @ pushed), rel=1e-9)
