"""Whatever limits a robot file has, a calibration stays calm below them, or says before that it cannot."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.arm.excitation import GRAVITY_MOTION, TORQUE_MOTION, ExcitationSettings, choose_path
from calibration.arm.model import GravityBodies
from calibration.encoder.stop_plan import plan_stops, with_room_for_stops
from control.arm.rigid_body import RigidBody
from palpate.runs import calibration as runs
from palpate.runs.robots import find_robot
from robot_io.errors import InputError
from tests.calibration.simulated import FOLLOWER, job_in, opened
from tests.palpate.cli import ROOT

BODY = RigidBody.from_urdf(FOLLOWER.urdf_path, FOLLOWER.tip_frame)
BODIES = GravityBodies.from_urdf(FOLLOWER.urdf_path, FOLLOWER.tip_frame)
HOME_RAD = np.array(FOLLOWER.home_rad)
SLOW_RAD_S = (0.55, 0.6, 0.5)


def limited(**limits):
    return FOLLOWER.model_copy(update={"limits": FOLLOWER.limits.model_copy(update=limits)})


def path_under(settings=TORQUE_MOTION, **limits):
    limits = limited(**limits).limits
    return choose_path(BODY, BODIES, HOME_RAD, limits, settings=settings, rng=np.random.default_rng(0))


def test_a_motion_in_free_air_runs_under_low_limits(tmp_path):
    job = job_in(tmp_path, "torque", [], robot=limited(velocity_rad_s=SLOW_RAD_S))
    runs.run_motion(job, ExcitationSettings(duration_s=8.0, period_s=4.0))
    ticks = opened(job).samples("tick")
    assert not ticks["guard_tripped"].any()
    assert np.all(np.abs(ticks["reference_velocity_rad_s"]).max(axis=0) < 0.6 * np.array(SLOW_RAD_S))


@pytest.mark.parametrize("kind", ["torque", "gravity", "encoder"])
def test_the_speed_that_is_announced_is_the_one_that_is_moved_at(kind):
    assert "0.6 rad/s" in runs.motion_in_words("encoder", FOLLOWER.limits)
    assert "up to 1.5 rad/s" in runs.motion_in_words("torque", FOLLOWER.limits)
    words = runs.motion_in_words(kind, limited(velocity_rad_s=(0.5, 0.5, 0.5)).limits)
    assert "up to 0.25 rad/s" in words
    assert "0.6" not in words


def largest_torques_nm(path):
    motions = (path.at(time_s) for time_s in np.linspace(0.0, path.duration_s, 400))
    return np.abs([BODY.inverse_dynamics(*motion) for motion in motions]).max(axis=0)


def test_a_weak_arm_chooses_a_motion_that_it_can_carry():
    weak_nm = np.array([10.0, 3.7, 0.45])
    assert np.any(largest_torques_nm(path_under()) > 0.85 * weak_nm)
    assert np.all(largest_torques_nm(path_under(torque_nm=tuple(weak_nm))) < 0.85 * weak_nm)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"velocity_rad_s": (6.0, 0.15, 6.0)}, r"velocity_rad_s of joint 2 is 0\.15 rad/s.* needs 0\.2"),
        ({"torque_nm": (5.0, 37.0, 18.0)}, r"joint 1: its limits\.torque_nm, 5 N m, hardly carries the arm"),
        ({"position_max_rad": (3.05, 2.75, -2.6)}, r"joint 3: .* are 0\.25 rad apart"),
    ],
)
def test_limits_that_leave_no_motion_are_named_before_anything_moves(limits, words):
    with pytest.raises(InputError, match=words):
        path_under(settings=GRAVITY_MOTION, **limits)


def test_the_shipped_dynamixel_arm_reaches_its_stops_from_home():
    robot = find_robot(str(ROOT / "robots/dynamixel_3dof.yaml"))
    body = RigidBody.from_urdf(robot.urdf_path, robot.tip_frame)
    home, limits = np.array(robot.home_rad), robot.limits
    _, approaches = plan_stops(body, home, limits, body.position_limits_rad, reach_rad=0.15)
    assert [approach.joint for approach in approaches] == [0, 1, 2]


def test_the_guard_opens_for_each_joint_towards_its_stop_alone():
    limits, stops = FOLLOWER.limits, BODY.position_limits_rad
    _, approaches = plan_stops(BODY, HOME_RAD, limits, stops, reach_rad=0.15)
    wider = with_room_for_stops(limits, approaches, 0.2)
    for approach in approaches:
        joint = approach.joint
        before = (limits.position_min_rad[joint], limits.position_max_rad[joint])
        after = (wider.position_min_rad[joint], wider.position_max_rad[joint])
        towards = approach.side > 0
        assert after[not towards] == before[not towards]
        assert after[towards] == pytest.approx(approach.stop_rad + 0.2 * approach.side)
    nearer = [
        replace(approach, stop_rad=0.0) for approach in approaches
    ]  # within the limits: no need for room
    assert with_room_for_stops(limits, nearer, 0.2) == limits


def test_an_arm_that_stands_too_high_for_its_stops_is_told_what_to_do_instead():
    """A floor above the elbow at its stop: lowest point of the arm in its highest posture."""
    upright = np.array([np.pi / 2, 0.0, 0.0])
    stops = BODY.position_limits_rad
    with pytest.raises(InputError, match=r"joint 1: .* m nearer to the ground .* higher; or .*--pose home"):
        plan_stops(BODY, upright, FOLLOWER.limits, stops, reach_rad=0.15)
    nowhere = (np.full(3, np.nan), np.full(3, np.nan))
    with pytest.raises(InputError, match=r"joint 1: no stop of it is stated.*--pose home"):
        plan_stops(BODY, HOME_RAD, FOLLOWER.limits, nowhere, reach_rad=0.15)
