"""Touching stops with devices as they are: an arm without a simulator, held where it is."""

import numpy as np
import pytest

from calibration.encoder.stop_plan import StopApproach
from calibration.encoder.stop_task import StopSettings, StopTask
from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from control.loop.phases import Phase
from robot_io.types import Measurement
from tests.calibration.simulated import FOLLOWER

DT = 1e-3
STEP_RAD_S = 0.0244  # of the speed on a 12-bit wire
STEP_RAD = 2 * np.pi / 4096


def phases(shown_rad, *, noise_rad_s, seconds):
    """What the task is in, tick by tick, with joint 1 at `shown_rad(k)` and noise on all speeds."""
    home = np.array(FOLLOWER.home_rad)
    body = RigidBody.from_urdf(FOLLOWER.urdf_path, FOLLOWER.tip_frame)
    approach = StopApproach(0, float(home[0]), 1, home)
    task = StopTask(body, gains_of(FOLLOWER).tracking, home, [approach], StopSettings.within(FOLLOWER.limits))
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


@pytest.mark.parametrize("noise_rad_s", [0.0, 0.01, 0.03])
def test_a_joint_at_its_stop_stands_however_noisy_its_speed_is(noise_rad_s):
    seen = phases(lambda k: STEP_RAD * (k % 3 == 0), noise_rad_s=noise_rad_s, seconds=20.0)
    assert seen[-1] is Phase.IDLE
    assert seen.count(Phase.HOLD) == 3 * 250


def test_a_joint_that_still_creeps_does_not_stand():
    seen = phases(lambda k: 0.015 * k * DT, noise_rad_s=0.0, seconds=8.0)
    assert Phase.HOLD not in seen
