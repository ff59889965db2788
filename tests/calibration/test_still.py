import io

import pytest

from calibration.still import StillRobot
from control.loop.tick_record import tick_stream
from palpate.commands.calibrate import ask_for_weight
from robot_io.clock import SimulatedClock
from robot_io.errors import DeviceTimeoutError, InputError, PalpateError, SafetyTripError
from robot_io.guard import Guard
from tests.control.loop_parts import MemoryLog
from tests.mock_robot import build_mock_robot, mock_robot_file


@pytest.fixture
def still():
    clock, robot_file = SimulatedClock(), mock_robot_file()
    guard = Guard(robot_file.limits, robot_file.safe_state, 3)
    with build_mock_robot(clock) as robot:
        yield StillRobot(robot, guard, clock, MemoryLog(), 1000.0)


def test_every_tick_is_logged_without_torque(still):
    still.await_samples()
    still.watch(0.05, 4)
    assert len(still.log.records) == 50
    names = [column.name for column in tick_stream(3).columns]
    for record in still.log.records:
        row = dict(zip(names, record, strict=True))
        assert row["run"] == 4
        assert not row["torque_sent_nm"].any()


def test_a_force_beyond_the_limit_ends_it_and_is_logged(still, monkeypatch):
    still.await_samples()
    read = still.robot.read
    monkeypatch.setattr(still.robot, "read", lambda deadline_s: read(deadline_s)._replace(force_n=31.0))
    with pytest.raises(SafetyTripError, match="contact force is 31 N"):
        still.watch(0.05)
    assert len(still.log.records) == 1


def test_a_device_that_never_samples_is_named(still, monkeypatch):
    robot = still.robot
    read = robot.read
    late = float("-inf")
    monkeypatch.setattr(robot, "read", lambda deadline_s: read(deadline_s)._replace(force_at_s=late))
    with pytest.raises(DeviceTimeoutError, match="force sensor"):
        still.await_samples()


def test_somebody_must_be_there_to_put_weights_on(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    ask_for_weight(9.8)(None, 2, 4.9)
    assert "3: put 0.5 kg (4.900 N) on the sensor" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(InputError, match="run this in a terminal"):
        ask_for_weight(9.8)(None, 0, 0.0)
    # An InputError would say that nothing was measured yet, and the session would be removed.
    with pytest.raises(PalpateError, match="no answer at weight 3") as late:
        ask_for_weight(9.8)(None, 2, 4.9)
    assert not isinstance(late.value, InputError)
