"""What goes wrong with Damiao motors, and what the robot makes of it."""

import numpy as np
import pytest

from robot_io.drivers.can.line import CanFrame
from robot_io.errors import DeviceError
from sim_backend.emulators import FaultKind
from tests.wire.parts import DAMIAO

TIMEOUT, MODE, VMAX = 9, 10, 22  # registers


@pytest.mark.parametrize(("stuck", "problem"), [(True, "torque off"), (False, "motor mode")])
def test_a_motor_is_on_or_off_once_it_says_so(bench, stuck, problem):
    """An answer alone is no confirmation."""
    arm = bench(DAMIAO)
    arm.robot.configure()
    if stuck:
        arm.robot.activate()

    class Stuck(type(arm.motors[0])):
        enabled = property(lambda self: stuck, lambda self, value: None)

    arm.motors[0].__class__ = Stuck
    with pytest.raises(DeviceError, match=rf"{problem} is not confirmed by joint 1 \(motor 1\)"):
        arm.robot.deactivate() if stuck else arm.robot.activate()


def test_a_late_answer_about_a_register_is_no_position(bench):
    arm = bench(DAMIAO).start()
    before = arm.tick().joint_position_rad
    bus = arm.robot.buses["motors"]
    bus._take(CanFrame(17, bytes((1, 0, 0x33, TIMEOUT, 0xD0, 0x07, 0, 0))), arm.clock.now_s())
    np.testing.assert_allclose(bus._position_rad, before)


def test_an_error_other_than_the_timeout_s_is_not_cleared_in_silence(bench):
    arm = bench(DAMIAO).start()
    arm.robot.deactivate()
    arm.strike("motors", FaultKind.ALERT, device=3, times=1)
    arm.ticks(2, None)
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"joint 3 \(motor 3\): MOSFET over temperature"):
            arm.robot.activate()
    assert arm.motors[2].error == 11
