"""Simulated robot behind robot_io's interfaces: robot files, clock, lifecycle."""

import shutil

import numpy as np
import pytest

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import InputError, LifecycleError
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Command, Status
from palpate.sim_backend.scenario import load_scenario
from tests.sim_backend.parts import ARM_NAMES, ARMS_DIR, inverse_dynamics

TICK_S = 1e-3


def build(name="follower", clock=None, path=None):
    robot_file = load_robot_file(path or ARMS_DIR / name / f"{name}.yaml")
    return build_robot(robot_file, DriverCatalog("palpate.sim_backend.drivers"), clock or SimulatedClock())


def world_of(robot):
    return robot.buses["world"].world


def holding_torque(robot):
    truth = world_of(robot).truth()
    return inverse_dynamics(world_of(robot), truth.joint_position_rad, np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("name", ARM_NAMES)
def test_shipped_arm_is_read_and_driven_tick_by_tick(name):
    with build(name) as robot:
        robot.activate()
        home = robot.read(0.0)
        torque = holding_torque(robot)
        for tick in range(1, 51):
            sent = robot.write(Command(torque), tick * TICK_S)
            robot.clock.sleep_until(tick * TICK_S)
            measured = robot.read(tick * TICK_S)
            assert measured.encoder_at_s == measured.force_at_s == pytest.approx(tick * TICK_S)
            assert measured.torque_at_s == pytest.approx((tick - 0.5) * TICK_S)
            assert (measured.encoder_status, measured.torque_status, measured.force_status) == (
                Status.OK,
            ) * 3
        assert np.allclose(measured.joint_position_rad, home.joint_position_rad, atol=1e-3)
        assert np.allclose(measured.joint_torque_nm, sent.joint_torque_nm, atol=0.06)
        assert abs(measured.force_n) < 0.1


def test_home_has_the_tool_down_above_every_shipped_object():
    for name in ARM_NAMES:
        with build(name) as robot:
            truth = world_of(robot).truth()
            assert sum(truth.joint_position_rad) == pytest.approx(-np.pi / 2, abs=1e-3)
            assert truth.tip_position_world_m == pytest.approx([0.40, 0.0, 0.18], abs=1e-3)


def test_sent_torque_has_drive_resolution_and_range():
    with build() as robot:
        robot.activate()
        sent = robot.write(Command(np.array([0.12345, -1000.0, 0.0])), 0.0).joint_torque_nm
        assert sent == pytest.approx([0.123, -40.0, 0.0], abs=1e-12)
        robot.clock.sleep_until(TICK_S)
        assert world_of(robot).truth().drive_torque_nm == pytest.approx(sent)


def test_arm_stands_on_its_rest_and_falls_when_switched_off_elsewhere():
    with build() as robot:
        world, clock = world_of(robot), robot.clock
        clock.sleep_until(0.2)
        assert world.truth().tip_position_world_m[2] == pytest.approx(0.18, abs=1e-4)
        robot.activate()
        robot.write(Command(holding_torque(robot)), 0.2)
        clock.sleep_until(0.21)
        assert world.truth().drive_torque_nm.any()
        robot.deactivate()
        assert not world.truth().drive_torque_nm.any()
        clock.sleep_until(0.41)
        # Its rest is still there
        assert world.truth().tip_position_world_m[2] == pytest.approx(0.18, abs=1e-3)
        robot.activate()
        world.place(world.truth().joint_position_rad + 0.02)
        robot.deactivate()
        clock.sleep_until(0.61)
        assert world.truth().tip_position_world_m[2] < 0.10
        with pytest.raises(LifecycleError):
            robot.torque.stage_torque(np.zeros(3))


def test_object_under_a_robot_can_change_and_be_chosen():
    robot = build()
    robot.buses["world"].use_scenario(load_scenario("stiff"))
    with robot:
        assert world_of(robot).object.law.stiffness_n_m == 7100.0
        world_of(robot).object.set_law(load_scenario("paper").object.law)
        assert world_of(robot).object.law.damping_n_s_m == 100.0
        with pytest.raises(LifecycleError, match="before the robot is configured"):
            robot.buses["world"].use_scenario(load_scenario("soft"))


def test_world_exists_from_configure_to_close():
    robot = build()
    with pytest.raises(LifecycleError, match="between configure and close"):
        world_of(robot)
    with robot:
        assert world_of(robot).time_s == 0.0
    with pytest.raises(LifecycleError, match="between configure and close"):
        world_of(robot)
    robot.clock.sleep_until(1.0)  # a world that has ended does not mind


class StepClock(Clock):
    """A clock that is no SimulatedClock and goes forward when told, as a machine's does by itself."""

    def __init__(self):
        self.time_s = 50.0

    def now_s(self):
        return self.time_s

    def sleep_until(self, time_s):
        self.time_s = max(self.time_s, time_s)


def test_world_advances_on_access_with_a_real_clock():
    clock = StepClock()
    with build(clock=clock) as robot:
        robot.activate()
        clock.time_s += 0.01
        assert robot.read(clock.time_s).encoder_at_s == pytest.approx(50.01)
        clock.time_s += 0.005
        robot.write(Command(np.array([1.0, 0.0, 0.0])), clock.time_s)
        assert world_of(robot).time_s == pytest.approx(50.015)
        # The time before the write passed under the old torque.
        assert robot.read(clock.time_s).joint_torque_nm[0] == pytest.approx(0.0, abs=0.06)
        clock.time_s += 0.005
        assert robot.read(clock.time_s).joint_torque_nm[0] == pytest.approx(1.0, abs=0.06)


def changed_robot_file(tmp_path, old, new):
    path = shutil.copytree(ARMS_DIR / "follower", tmp_path / "arm") / "follower.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("scenario: default", "scenario: defaul", "no scenario 'defaul'"),
        ("scenario: default", "scenery: default", "buses.world.scenery: .*did you mean 'scenario'"),
        ("{driver: sim_force, bus", "{driver: sim_force, noise: 1, bus", "force.noise: is not"),
        ("{driver: sim_force, bus: world}", "{driver: sim_force}", "bus whose driver is 'pybullet'"),
    ],
)
def test_wrong_setting_is_refused_before_anything_is_built(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words):
        build(path=changed_robot_file(tmp_path, old, new))


def test_mismatched_urdf_is_refused_with_both_files(tmp_path):
    robot = build(path=changed_robot_file(tmp_path, "tip_frame: tip", "tip_frame: nose"))
    with pytest.raises(InputError, match=r"follower.yaml with follower.urdf: .*no link 'nose'"):
        robot.configure()
