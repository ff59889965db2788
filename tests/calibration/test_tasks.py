"""Calibration motions: hard stops, an unpowered robot, free air, and the pace under low limits."""

import io
from dataclasses import replace

import numpy as np
import pytest

from palpate.calibration.arm_motion import (
    GRAVITY_MOTION,
    TORQUE_MOTION,
    ExcitationSettings,
    FreeMotion,
    choose_path,
)
from palpate.calibration.encoder import (
    StopApproach,
    StopSettings,
    StopTask,
    plan_stops,
    widen_limits_for_stops,
)
from palpate.calibration.standstill import StationaryRobot
from palpate.commands.calibrate import ask_for_weight
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import TrackingGains, gains_of
from palpate.control.loop.task import Phase
from palpate.control.loop.tick_record import tick_stream
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.errors import DeviceTimeoutError, InputError, PalpateError, SafetyTripError
from palpate.robot_io.guard import Guard
from palpate.robot_io.types import Measurement
from palpate.runs import calibration as runs
from palpate.runs.robots import find_robot
from tests.calibration.simulated import FOLLOWER, job_in, opened
from tests.control.loop_parts import MemoryLog
from tests.mock_robot import build_mock_robot, mock_robot_file
from tests.palpate.cli import ROOT

DT = 1e-3
STEP_RAD_S = 0.0244  # of the speed on a 12-bit wire
STEP_RAD = 2 * np.pi / 4096
REST = Measurement(0.0, np.array(FOLLOWER.home_rad), np.zeros(3), np.zeros(3), 0.2, 0.0, 0.0, 0.0)
SHAKING = REST._replace(joint_velocity_rad_s=np.array([0.0, 0.1, 0.0]))
BODY = RigidBody.from_urdf(FOLLOWER.urdf_path, FOLLOWER.tip_frame)
HOME_RAD = np.array(FOLLOWER.home_rad)
SLOW_RAD_S = (1.15, 1.3, 1.18)


def phases(shown_rad, *, noise_rad_s, seconds):
    """What the task is in, tick by tick, with joint 1 at `shown_rad(k)` and noise on all speeds."""
    home, settings = HOME_RAD, StopSettings.within(FOLLOWER.limits)
    approach = StopApproach(0, float(home[0]), 1, home)
    task = StopTask(BODY, gains_of(FOLLOWER).tracking, home, [approach], settings)
    rng = np.random.default_rng(0)

    def measured(k):
        position = home + np.array([shown_rad(k), 0.0, 0.0])
        speed = np.round(rng.normal(0.0, noise_rad_s, 3) / STEP_RAD_S) * STEP_RAD_S
        return Measurement(k * DT, position, speed, np.zeros(3), 0.0, k * DT, k * DT, k * DT)

    task.start(measured(0))
    seen = []
    while len(seen) < seconds / DT and Phase.IDLE not in seen[-1:]:
        seen.append(task.step(measured(len(seen) + 1), DT).phase)
    return seen


@pytest.mark.parametrize("noise_rad_s", [0.0, 0.03])
def test_joint_at_its_stop_is_at_rest_despite_velocity_noise(noise_rad_s):
    seen = phases(lambda k: STEP_RAD * (k % 3 == 0), noise_rad_s=noise_rad_s, seconds=20.0)
    assert seen[-1] is Phase.IDLE
    assert seen.count(Phase.HOLD) == 3 * 250


def test_creeping_joint_is_not_at_rest():
    assert Phase.HOLD not in phases(lambda k: 0.015 * k * DT, noise_rad_s=0.0, seconds=4.0)


@pytest.fixture
def still():
    clock, robot_file = SimulatedClock(), mock_robot_file()
    guard = Guard(robot_file.limits, robot_file.safe_state, 3)
    with build_mock_robot(clock) as robot:
        yield StationaryRobot(robot, guard, clock, MemoryLog(), 1000.0)


def test_every_tick_is_logged_without_torque(still):
    still.await_samples()
    still.record(0.05, 4)
    assert len(still.log.records) == 50
    names = [column.name for column in tick_stream(3).columns]
    for record in still.log.records:
        row = dict(zip(names, record, strict=True))
        assert row["run"] == 4
        assert not row["torque_sent_nm"].any()


def test_force_beyond_the_limit_ends_the_weighing_and_is_logged(still, monkeypatch):
    still.await_samples()
    read = still.robot.read
    monkeypatch.setattr(still.robot, "read", lambda deadline_s: read(deadline_s)._replace(force_n=31.0))
    with pytest.raises(SafetyTripError, match="contact force is 31 N"):
        still.record(0.05)
    assert len(still.log.records) == 1


def test_silent_device_is_named(still, monkeypatch):
    robot = still.robot
    read = robot.read
    late = float("-inf")
    monkeypatch.setattr(robot, "read", lambda deadline_s: read(deadline_s)._replace(force_at_s=late))
    with pytest.raises(DeviceTimeoutError, match="force sensor"):
        still.await_samples()


def test_weighing_requires_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    ask_for_weight(9.8, None, 2, 4.9)
    assert "3: put 0.5 kg (4.900 N) on the sensor" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(InputError, match="run this in a terminal"):
        ask_for_weight(9.8, None, 0, 0.0)
    # An InputError would say that nothing was measured yet, and the session would be removed.
    with pytest.raises(PalpateError, match="no answer at weight 3") as late:
        ask_for_weight(9.8, None, 2, 4.9)
    assert not isinstance(late.value, InputError)


@pytest.fixture
def free():
    motion = FreeMotion(BODY, TrackingGains())
    motion.start(REST)
    return motion


def test_moving_arm_is_reported_after_a_timeout_with_a_remedy(free):
    assert free.at_rest(REST, 0.0)
    assert free.at_rest(REST, 10.0)
    assert not free.at_rest(SHAKING, 1.9)
    with pytest.raises(SafetyTripError, match=r"to rest; if it shakes, lower gains\.tracking\.bandwidth"):
        free.at_rest(SHAKING, 2.1)


def limited(**limits):
    return FOLLOWER.model_copy(update={"limits": FOLLOWER.limits.model_copy(update=limits)})


def path_under(settings=TORQUE_MOTION, **limits):
    limits = limited(**limits).limits
    return choose_path(BODY, HOME_RAD, limits, settings=settings, rng=np.random.default_rng(0))


def test_free_air_motion_runs_under_low_limits(tmp_path, log_in_process):
    job = job_in(tmp_path, "torque", [], robot=limited(velocity_rad_s=SLOW_RAD_S))
    runs.run_motion(job, ExcitationSettings(duration_s=1.0, period_s=1.0))
    ticks = opened(job).samples("tick")
    assert not ticks["guard_tripped"].any()
    assert np.all(np.abs(ticks["reference_velocity_rad_s"]).max(axis=0) < 0.6 * np.array(SLOW_RAD_S))


@pytest.mark.parametrize("kind", ["torque", "gravity", "encoder"])
def test_announced_speed_is_the_executed_speed(kind):
    assert "0.6 rad/s" in runs.describe_motion("encoder", FOLLOWER.limits)
    assert "up to 1.5 rad/s" in runs.describe_motion("torque", FOLLOWER.limits)
    words = runs.describe_motion(kind, limited(velocity_rad_s=(0.5, 0.5, 0.5)).limits)
    assert "up to 0.25 rad/s" in words
    assert "0.6" not in words


def largest_torques_nm(path):
    motions = (path.at(time_s) for time_s in np.linspace(0.0, path.duration_s, 400))
    return np.abs([BODY.inverse_dynamics(*motion) for motion in motions]).max(axis=0)


def test_weak_arm_gets_a_motion_within_its_torque():
    weak_nm = np.array([10.0, 3.7, 0.45])
    assert np.any(largest_torques_nm(path_under()) > 0.85 * weak_nm)
    assert np.all(largest_torques_nm(path_under(torque_nm=tuple(weak_nm))) < 0.85 * weak_nm)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"velocity_rad_s": (6.0, 0.15, 6.0)}, r"velocity_rad_s of joint 2 is 0\.15 rad/s.* needs 0\.2"),
        ({"torque_nm": (5.0, 37.0, 18.0)}, r"joint 1: its limits\.torque_nm, 5 N m, cannot carry the arm"),
        ({"position_max_rad": (3.05, 2.75, -2.6)}, r"joint 3: .* are 0\.25 rad apart"),
    ],
)
def test_limits_without_feasible_motion_are_named_before_moving(limits, words):
    with pytest.raises(InputError, match=words):
        path_under(settings=GRAVITY_MOTION, **limits)


def test_shipped_dynamixel_arm_reaches_its_stops_from_home():
    robot = find_robot(str(ROOT / "robots/dynamixel_3dof.yaml"))
    body = RigidBody.from_urdf(robot.urdf_path, robot.tip_frame)
    home, limits = np.array(robot.home_rad), robot.limits
    _, approaches = plan_stops(body, home, limits, body.position_limits_rad, reach_rad=0.15)
    assert [approach.joint for approach in approaches] == [0, 1, 2]


def test_guard_opens_each_joint_only_towards_its_stop():
    limits, stops = FOLLOWER.limits, BODY.position_limits_rad
    _, approaches = plan_stops(BODY, HOME_RAD, limits, stops, reach_rad=0.15)
    wider = widen_limits_for_stops(limits, approaches, 0.2)
    for approach in approaches:
        joint = approach.joint
        before = (limits.position_min_rad[joint], limits.position_max_rad[joint])
        after = (wider.position_min_rad[joint], wider.position_max_rad[joint])
        towards = approach.side > 0
        assert after[not towards] == before[not towards]
        assert after[towards] == pytest.approx(approach.stop_rad + 0.2 * approach.side)
    nearer = [replace(approach, stop_rad=0.0) for approach in approaches]  # inside: no need for room
    assert widen_limits_for_stops(limits, nearer, 0.2) == limits


def test_arm_too_high_for_its_stops_is_refused_with_a_remedy():
    """A floor above the elbow at its stop: lowest point of the arm in its highest posture."""
    upright = np.array([np.pi / 2, 0.0, 0.0])
    stops = BODY.position_limits_rad
    with pytest.raises(
        InputError, match=r"joint 1: .* m closer to the ground .* raise the arm by as much, or .*--pose home"
    ):
        plan_stops(BODY, upright, FOLLOWER.limits, stops, reach_rad=0.15)
    nowhere = (np.full(3, np.nan), np.full(3, np.nan))
    with pytest.raises(InputError, match=r"joint 1: its stops are not stated.*--pose home"):
        plan_stops(BODY, HOME_RAD, FOLLOWER.limits, nowhere, reach_rad=0.15)
