import numpy as np
import pytest

from calibration.arm.free_motion import FreeMotion
from control.arm.rigid_body import RigidBody
from control.laws.gains import TrackingGains
from robot_io.errors import SafetyTripError
from robot_io.types import Measurement
from tests.calibration.simulated import FOLLOWER

REST = Measurement(0.0, np.array(FOLLOWER.home_rad), np.zeros(3), np.zeros(3), 0.2, 0.0, 0.0, 0.0)
SHAKING = REST._replace(joint_velocity_rad_s=np.array([0.0, 0.1, 0.0]))


@pytest.fixture
def free():
    motion = FreeMotion(RigidBody.from_urdf(FOLLOWER.urdf_path, FOLLOWER.tip_frame), TrackingGains())
    motion.start(REST)
    return motion


def test_an_arm_that_shakes_at_the_end_is_waited_for_and_then_told_about_with_a_remedy(free):
    assert free.at_rest(REST, 0.0)
    assert free.at_rest(REST, 10.0)
    assert not free.at_rest(SHAKING, 1.9)
    with pytest.raises(SafetyTripError, match=r"to rest; if it shakes, lower gains\.tracking\.bandwidth"):
        free.at_rest(SHAKING, 2.1)
