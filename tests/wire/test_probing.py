"""A whole probing run through real drivers and emulated devices, and what a fault on the way does."""

from datetime import UTC, datetime

import numpy as np
import pytest

from control.loop.loop import run_loop
from control.loop.result import LoopResult, Outcome
from control.loop.tick_record import tick_stream
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from estimation.data.channels import session_channels
from estimation.study.estimates import estimate_with
from robot_io import Session, SessionMetadata, SessionWriter
from robot_io.clock import SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.guard import Guard
from robot_io.robot import build_robot
from robot_io.robot_file import load_robot_file
from sim_backend.emulators import Fault, FaultKind
from tests.wire.parts import CUBEMARS, ODRIVE, ROOT

PLAN = ProbingPlan(speeds_m_s=(0.12, 0.06), hold_s=0.1, free_air_s=0.1)


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
    with SessionWriter(path, [tick_stream(robot.joint_count)], metadata, wait_for_room=True) as log:
        return run_loop(robot, guard, task, clock, log, rate_hz=robot_file.control_rate_hz)


def stiffness_and_damping(path):
    """By name: value, and its standard error."""
    (channel,) = (c for c in session_channels(Session.open(path), tared=True) if c.name == "contact")
    (estimate,) = estimate_with(channel, "kelvin_voigt", ["lsq"]).estimates
    wanted = ("stiffness", "damping")
    return {p.name: (p.value, p.std_err) for p in estimate.parameters if p.name.startswith(wanted)}


@pytest.fixture(scope="module")
def direct(tmp_path_factory):
    """Stiffness and damping as the simulated drivers measure them."""
    path = tmp_path_factory.mktemp("direct") / "direct.mcap"
    clock, robot_file = SimulatedClock(), load_robot_file(ROOT / "sim_backend/arms/follower/follower.yaml")
    robot = build_robot(robot_file, DriverCatalogue("sim_backend.drivers"), clock)
    assert probe(robot, robot_file, clock, path).outcome is Outcome.FINISHED
    return stiffness_and_damping(path)


@pytest.mark.parametrize(
    ("robot_file", "share"), [(ODRIVE, 0.005), (CUBEMARS, 0.04)], ids=["odrive", "cubemars"]
)
def test_the_object_is_the_same_over_the_wire(bench, direct, tmp_path, robot_file, share):
    """CubeMars' 12 bits of velocity are 12 mrad/s a step, which is what the damping then is uncertain by."""
    arm = bench(robot_file)
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, tmp_path / "wire.mcap")
    assert result.outcome is Outcome.FINISHED, result.cause
    wired = stiffness_and_damping(tmp_path / "wire.mcap")
    assert len(direct) == 2
    for name, (value, _) in direct.items():
        assert wired[name][0] == pytest.approx(value, rel=share)


@pytest.mark.parametrize(
    ("robot_file", "bus", "kind", "details", "cause"),
    [
        (ODRIVE, "motors", FaultKind.ALERT, {"device": 1, "times": 1}, "INVERTER_OVER_TEMP"),
        (ODRIVE, "motors", FaultKind.DROP, {"device": 2}, "node 2"),
        (ODRIVE, "motors", FaultKind.UNPLUG, {}, "bus-off"),
        (CUBEMARS, "motors", FaultKind.ALERT, {"device": 1, "times": 1}, "MOSFET over temperature"),
        (ODRIVE, "load_cell", FaultKind.DROP, {}, "no reading for"),
        (CUBEMARS, "load_cell", FaultKind.UNPLUG, {}, "serial port"),
    ],
)
def test_a_fault_on_the_way_ends_without_torque_and_with_its_name(
    bench, tmp_path, robot_file, bus, kind, details, cause
):
    arm = bench(robot_file)
    fault_s = 1.2  # under way to the object
    arm.faults[bus].add(Fault(kind=kind, from_s=fault_s, **details))
    path = tmp_path / "wire.mcap"
    result = probe(arm.robot, arm.arm.robot_file, arm.clock, path)
    assert result.outcome is Outcome.TRIPPED
    assert cause in result.cause
    arm.clock.sleep_until(arm.clock.now_s() + 0.2)
    assert np.abs(arm.drive_torque_nm).max() < 0.02
    session = Session.open(path)
    assert not session.truncated
    assert session.samples("tick")["time_s"][-1] >= fault_s
    assert any(cause in event.text for event in session.events)
