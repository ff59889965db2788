"""A whole probing run through the Dynamixel drivers, with 12-bit encoders."""

import pytest

from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import Outcome
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.guard import Guard
from palpate.sim_backend.imperfections.joint import HiddenCoulombFriction
from tests.control.loop_parts import MemoryLog
from tests.wire.parts import DYNAMIXEL

pytestmark = pytest.mark.slow

PLAN = ProbingPlan(speeds_m_s=(0.12, 0.06), hold_s=0.1, free_air_s=0.1)
RUBBING_NM = (0.5, 0.3, 0.05)  # in gears of this size


def test_stiction_is_no_stuck_encoder(make_robot):
    arm = make_robot(
        DYNAMIXEL, hidden=[HiddenCoulombFriction(joint=j, coulomb_nm=f) for j, f in enumerate(RUBBING_NM, 1)]
    )
    robot_file = arm.arm.robot_file
    guard = Guard(robot_file.limits, robot_file.safe_state, 3)
    arm.robot.configure()
    task = ProbingTask.from_robot_file(robot_file, PLAN)
    rate_hz = robot_file.control_rate_hz
    result = run_loop(arm.robot, guard, task, arm.clock, MemoryLog(), rate_hz=rate_hz)
    assert result.outcome is Outcome.FINISHED, result.cause
