"""A whole probing run through the Dynamixel drivers byte by byte, and what faults on the way do to it."""

from datetime import UTC, datetime

import pytest

from control.loop.loop import run_loop
from control.loop.result import LoopResult, Outcome
from control.loop.tick_record import tick_stream
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from estimation.data.channels import session_channels
from estimation.study.estimates import estimate_with
from robot_io import Session, SessionMetadata
from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.guard import Guard
from robot_io.robot import build_robot
from robot_io.robot_file import parse_robot_file
from sim_backend.imperfections.friction import CoulombFriction
from tests.log_in_process import LogInProcess
from tests.wire.parts import ROOT

pytestmark = pytest.mark.slow

PLAN = ProbingPlan(speeds_m_s=(0.12, 0.06), hold_s=0.1, free_air_s=0.1)
ROBOT = ROOT / "robots" / "dynamixel_3dof.yaml"
SIMULATED = """buses:
  world: {driver: pybullet, scenario: default}
encoder: {driver: sim_encoder, bus: world}
torque: {driver: sim_torque, bus: world}
force: {driver: sim_force, bus: world}
"""


def probe(robot, robot_file, clock, path) -> LoopResult:
    metadata = SessionMetadata(
        robot_file=robot_file.text,
        urdf=robot_file.urdf_path.read_text(encoding="utf-8"),
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        extra={"source": "simulated"},
    )
    task = ProbingTask.from_robot_file(robot_file, PLAN)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot.joint_count)
    robot.configure()
    with LogInProcess(path, [tick_stream(robot.joint_count)], metadata) as log:
        return run_loop(robot, guard, task, clock, log, rate_hz=robot_file.control_rate_hz)


def stiffness_and_damping(path):
    """By name: value, and its standard error."""
    (channel,) = (c for c in session_channels(Session.open(path), tared=True) if c.name == "contact")
    (estimate,) = estimate_with(channel, "kelvin_voigt", ["lsq"]).estimates
    wanted = ("stiffness", "damping")
    return {p.name: (p.value, p.std_err) for p in estimate.parameters if p.name.startswith(wanted)}


@pytest.fixture(scope="module")
def direct(tmp_path_factory):
    """The same arm with the simulation's own drivers."""
    text = ROBOT.read_text(encoding="utf-8")
    text = text[: text.index("buses:")] + SIMULATED + text[text.index("home_rad:") :]
    path = tmp_path_factory.mktemp("direct") / "direct.mcap"
    robot_file, clock = parse_robot_file(text, ROBOT), SimulatedClock()
    robot = build_robot(robot_file, DriverCatalogue("sim_backend.drivers"), clock)
    assert probe(robot, robot_file, clock, path).outcome is Outcome.FINISHED
    return stiffness_and_damping(path)


@pytest.mark.parametrize(
    "changes",
    [[], [("velocity: servo", "velocity: difference"), ("fast_sync_read: true", "fast_sync_read: false")]],
    ids=["fast, servo's velocity", "plain, difference"],
)
def test_the_object_is_the_same_over_the_wire(bench, direct, tmp_path, changes):
    """Within what steps of 0.4 mm and 6 mm/s at the tip leave uncertain."""
    arm = bench(ROBOT, changes)
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, tmp_path / "wire.mcap")
    assert result.outcome is Outcome.FINISHED, result.cause
    wired = stiffness_and_damping(tmp_path / "wire.mcap")
    for name, (value, _) in direct.items():
        assert wired[name][0] == pytest.approx(value, rel=0.02)
        assert abs(wired[name][0] - value) < 4 * wired[name][1]


def test_joints_that_friction_holds_are_no_stuck_encoders(bench, tmp_path):
    """Encoders of twelve bits, and the friction of gears of this size."""
    rubbing = [
        CoulombFriction(joint=joint, coulomb_nm=torque_nm)
        for joint, torque_nm in ((1, 0.5), (2, 0.3), (3, 0.05))
    ]
    arm = bench(ROBOT, hidden=rubbing)
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, tmp_path / "wire.mcap")
    assert result.outcome is Outcome.FINISHED, result.cause
