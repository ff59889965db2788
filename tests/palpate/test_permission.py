"""A real arm gets power only with permission; a simulated one needs none."""

import io

import pytest

from palpate.robot_io.errors import InputError
from palpate.runs import options
from palpate.runs.options import ask_for_pose, ask_for_power
from tests.mock_robot import MockTorque, write_mock_files
from tests.palpate.cli import ROOT, assert_refused, done, run

pytestmark = pytest.mark.usefixtures("log_in_process")

SERVOS = ROOT / "robots" / "dynamixel_3dof.yaml"


class Terminal(io.StringIO):
    """Somebody who types."""

    def isatty(self) -> bool:
        return True


def types(monkeypatch, text: str) -> None:
    monkeypatch.setattr("sys.stdin", Terminal(text))


@pytest.fixture
def power(monkeypatch):
    """Notes each time that the mock robot's drives are switched on."""
    switched_on = []
    activate = MockTorque.activate

    def noted(self):
        switched_on.append(self)
        activate(self)

    monkeypatch.setattr(MockTorque, "activate", noted)
    return switched_on


MOVING = (("probe",), ("calibrate", "torque"), ("calibrate", "gravity"), ("calibrate", "encoder"))


@pytest.mark.parametrize("command", MOVING, ids=" ".join)
def test_real_arm_moves_only_with_a_terminal_or_yes(command, tmp_path, monkeypatch, power):
    monkeypatch.chdir(tmp_path)
    own = ("--robot", write_mock_files(tmp_path), "--drivers", "tests.mock_robot")
    assert_refused(run(*command, *own), "--yes", "--wire", "terminal")
    assert power == []
    assert not list(tmp_path.rglob("*.mcap"))
    assert not list(tmp_path.rglob("*.png"))
    out = tmp_path / "out.mcap"
    assert_refused(run(*command, "--robot", SERVOS, "-o", out), "--yes")  # and not: no such port


def test_confirmation_question_describes_the_motion(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("palpate.commands.probe.ask_for_power", lambda text, yes: asked.append((text, yes)))
    options = ("--speed-mm-s", "20,12.5", "--force-limit-n", 3, "--repeats", 2, "--yes")
    run("probe", "--robot", SERVOS, "-o", tmp_path / "x.mcap", *options)
    ((text, yes),) = asked
    assert yes
    for word in ("'dynamixel_3dof'", "4 runs", "20, 12.5 mm/s", "3 N", "beyond 40 N"):
        assert word in text


def test_declined_confirmation_stops(monkeypatch, capsys):
    types(monkeypatch, "n\n")
    with pytest.raises(InputError, match="nothing has moved"):
        ask_for_power("'it' will move", yes=False, pause=pytest.fail)
    types(monkeypatch, "\n")
    with pytest.raises(InputError, match="nothing has moved"):
        ask_for_power("'it' will move", yes=False, pause=pytest.fail)
    said = capsys.readouterr()
    assert said.out == ""
    for words in ("'it' will move", "Keep clear", "[y/N]"):
        assert words in said.err


@pytest.mark.parametrize("yes", [True, False])
def test_confirmation_starts_a_countdown(monkeypatch, capsys, yes):
    types(monkeypatch, "" if yes else "y\n")
    pauses = []
    ask_for_power("'it' will move", yes=yes, pause=pauses.append)
    assert sum(pauses) == 3.0
    assert "power in 3 s" in capsys.readouterr().err


def test_pose_is_read_after_confirmation(monkeypatch, capsys):
    types(monkeypatch, "\n")
    ask_for_pose([0.1, 1.25, -0.3], yes=False)
    assert "0.1, 1.25, -0.3 rad" in capsys.readouterr().err
    types(monkeypatch, "")
    with pytest.raises(InputError, match="the pose is not confirmed"):
        ask_for_pose([0.1], yes=False)


def test_pose_of_a_real_arm_is_not_read_unattended(tmp_path, monkeypatch, power):
    monkeypatch.chdir(tmp_path)
    own = ("--robot", write_mock_files(tmp_path), "--drivers", "tests.mock_robot", "--pose", "home")
    assert_refused(run("calibrate", "encoder", *own), "a person must bring", "--yes")
    assert not list(tmp_path.rglob("*.mcap"))
    done("calibrate", "encoder", *own, "--yes", "-o", "e.yaml", "--session", "e.mcap")
    assert power == []


def test_error_for_a_missing_port_names_the_robot_file_and_a_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr(options, "COUNTDOWN_S", 0)
    out = tmp_path / "x.mcap"
    result = run("probe", "--robot", SERVOS, "-o", out, "--yes")
    assert result.exit_code == 2
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("palpate:")]
    for words in ("dynamixel_3dof.yaml", "bus 'motors'", "No such file", "palpate doctor --robot"):
        assert words in line
    assert not out.exists()


def test_arm_beyond_its_limits_is_to_be_moved_by_hand(tmp_path, monkeypatch):
    monkeypatch.setattr(options, "COUNTDOWN_S", 0)
    robot = write_mock_files(tmp_path)
    text = robot.read_text()
    beyond = text.replace("driver: mock_bus", "driver: mock_bus, start_rad: [-2.7, 0.0, 0.0]")
    assert beyond != text
    robot.write_text(beyond.replace("_age_s: 0.005", "_age_s: 1.0"))  # a busy machine is no failure
    own = ("--robot", robot, "--drivers", "tests.mock_robot", "-o", tmp_path / "x.mcap", "--yes")
    result = run("probe", *own)
    assert result.exit_code == 1, result.stderr
    assert "joint 1 is at -2.7 rad" in result.stdout
    assert "by hand" in result.stdout
    assert "palpate estimate" not in result.stderr
