"""Hybrid controller: hysteresis, debounce and bumpless switching."""

import numpy as np
import pytest

from palpate.control.arm.inverse_kinematics import Elbow, PlanarArm
from palpate.control.laws.gains import Gains, TouchGains
from palpate.control.laws.hybrid import ContactSwitch, ForceGoal, HybridController, HybridReference
from palpate.control.paths.press_line import PressLine
from palpate.control.paths.trajectory import LineState, SpeedBlend
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import Status
from tests.control.probing_runs import TICK_S, plant_above
from tests.control.reference_plant import DOWN, TOOL_AXIS_TIP, test_arm


def switch(debounce: int = 3) -> ContactSwitch:
    return ContactSwitch(TouchGains(debounce_samples=debounce, release_share=0.5), 1.0)


def states(contact: ContactSwitch, forces) -> list[bool]:
    return [contact.update(force) for force in forces]


def test_contact_needs_repeated_samples_and_has_hysteresis():
    contact = switch()
    assert states(contact, [2, 2, 0, 2, 2, 0, 2, 2]) == [False] * 8
    assert states(contact, [2]) == [True]
    free, touching = switch(), switch()
    states(touching, [2, 2, 2])
    assert not any(states(free, [0.9] * 20))
    assert all(states(touching, [0.6] * 20))
    assert states(touching, [0.4, 0.4, 0.4]) == [True, True, False]


class HybridSetup:
    """The controller on the reference plant, along a line under the tip."""

    def __init__(self, height_m: float = 0.06, **plant) -> None:
        self.plant = plant_above(height_m=height_m, **plant)
        body = test_arm()
        self.control = HybridController(body, TOOL_AXIS_TIP, Gains())
        start, _ = body.tip_pose(self.plant.position_rad)
        self.control.start(self.plant.measure())
        self.control.set_line(PressLine(PlanarArm(body, TOOL_AXIS_TIP), start, DOWN, Elbow.POSITIVE), 0.0)
        self.torques, self.states, self.contact, self.forces = [], [], [], []

    def tick(self, reference: HybridReference) -> None:
        output = self.control.step(self.plant.measure(), reference, TICK_S)
        self.torques.append(output.command.joint_torque_nm)
        self.states.append(output.state)
        self.contact.append(output.in_contact)
        self.forces.append(output.force_n)
        self.plant.advance(output.command.joint_torque_nm, TICK_S)


def press_and_leave(setup: HybridSetup, speed_m_s: float = 0.06) -> HybridSetup:
    approach = SpeedBlend(LineState(0.0), speed_m_s, 3.0)
    load = ForceGoal(10.0, speed_m_s, hold=False)
    for tick in range(500):
        setup.tick(HybridReference(approach.at(tick * TICK_S), load))
        if setup.contact[-1]:
            break
    for _ in range(300):
        setup.tick(HybridReference(force=load))
    for _ in range(500):
        setup.tick(HybridReference(force=load._replace(hold=True)))
    leave = SpeedBlend(setup.states[-1]._replace(acceleration_m_s2=0.0), -speed_m_s, 3.0)
    for tick in range(1, 2400):
        setup.tick(HybridReference(free=leave.at(tick * TICK_S)))
    return setup


@pytest.mark.parametrize(
    ("stiffness", "damping"), [(100.0, 0.0), (500.0, 20.0), (2000.0, 50.0), (10_000.0, 0.0)]
)
def test_switch_is_bumpless_both_ways(stiffness, damping):
    setup = press_and_leave(HybridSetup(stiffness_n_m=stiffness, damping_n_s_m=damping))
    torques, forces = np.array(setup.torques), np.array(setup.forces)
    # The torques balance the measured force; what the controller itself adds at the switch is a bump.
    reach_m = 0.6
    for to in (True, False):
        tick = next(i for i in range(1, len(setup.contact)) if setup.contact[i] is to != setup.contact[i - 1])
        force_step_nm = reach_m * np.abs(np.diff(forces[tick - 3 : tick + 4])).max()
        around = np.abs(np.diff(torques[tick - 2 : tick + 4], axis=0)).max()
        assert around < 0.6 + 1.5 * force_step_nm
    travel = np.array([state.travel_m for state in setup.states])
    speed = np.array([state.speed_m_s for state in setup.states])
    assert np.abs(np.diff(travel)).max() < 0.065 * TICK_S
    assert np.abs(np.diff(speed)).max() <= Gains().contact.yielding_m_s2 * TICK_S + 1e-9
    assert travel[1:] - travel[:-1] == pytest.approx((speed[1:] + speed[:-1]) / 2 * TICK_S, abs=2e-7)


def test_without_force_goal_motion_is_followed_even_in_contact():
    setup = HybridSetup(height_m=0.055, stiffness_n_m=500.0)
    down = SpeedBlend(LineState(0.0), 0.03, 3.0)
    for tick in range(400):
        setup.tick(HybridReference(free=down.at(tick * TICK_S)))
    assert setup.contact[-1]
    assert setup.states[-1] == down.at(399 * TICK_S)


def test_stale_force_proves_no_contact():
    setup = HybridSetup()
    setup.plant.force_bias_n = 5.0
    measurement = setup.plant.measure()
    still = HybridReference(free=LineState(0.0))
    for tick in range(20):
        late = measurement._replace(time_s=tick * TICK_S)  # sampled at the same time, again and again
        assert not setup.control.step(late, still, TICK_S).in_contact
    for tick in range(20, 40):
        fault = measurement._replace(force_at_s=tick * TICK_S, force_status=Status.FAULT)
        assert not setup.control.step(fault, still, TICK_S).in_contact


def test_misuse_is_refused():
    control = HybridController(test_arm(), TOOL_AXIS_TIP, Gains())
    measurement = plant_above().measure()
    control.start(measurement)
    with pytest.raises(InputError, match="set_line"):
        control.step(measurement, HybridReference(free=LineState(0.0)), TICK_S)
    setup = HybridSetup()
    with pytest.raises(InputError, match="neither a motion nor a force"):
        setup.tick(HybridReference())
