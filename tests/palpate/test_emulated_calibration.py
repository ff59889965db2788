"""What was found out about emulated devices is never applied to the arm that they stand for."""

import pytest

from palpate.words import FIRST_PROBE
from robot_io.calibration import load_calibration
from tests.palpate.cli import ROOT, assert_refused, run


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A robot file of real drivers that names a calibration made with --wire."""
    folder = tmp_path_factory.mktemp("wired")
    shipped = (ROOT / "robots/dynamixel_3dof.yaml").read_text()
    path = folder / "arm.yaml"
    path.write_text(shipped.replace(": dynamixel_3dof.", f": {ROOT}/robots/dynamixel_3dof."))
    out = folder / "e.yaml"
    options = ("--wire", "--pose", "home", "-o", out, "--session", folder / "e.mcap")
    result = run("calibrate", "encoder", "--robot", path, *options)
    assert result.exit_code == 0, result.stderr
    assert "on the arm itself refused" in result.stderr
    assert f"palpate probe --robot {path} --wire {FIRST_PROBE}" in result.stderr
    assert "once the robot file names it" in result.stderr
    path.write_text(path.read_text() + "\ncalibration: {encoder: e.yaml}\n")
    return path


def test_it_says_so(arm):
    assert load_calibration(arm.parent / "e.yaml").source == "emulated"


@pytest.mark.parametrize("command", [("probe",), ("calibrate", "torque")], ids=" ".join)
def test_the_arm_itself_refuses_it(arm, command, tmp_path):
    result = run(*command, "--robot", arm, "-o", tmp_path / "x", "--yes")
    assert_refused(result, "calibration.encoder", "'e.yaml'", "emulated devices", "palpate calibrate encoder")


def test_the_emulated_devices_take_it(arm, tmp_path):
    short = ("--speed-mm-s", 100, "--hold-s", 0.05, "--online", "none")
    result = run("probe", "--robot", arm, "--wire", "-o", tmp_path / "x.mcap", *short)
    assert result.exit_code == 0, result.stderr
    assert "encoder" in run("info", tmp_path / "x.mcap", "--json").stdout


def test_so_does_the_doctor(arm):
    assert run("doctor", "--robot", arm, "--wire").exit_code == 0
    result = run("doctor", "--robot", arm)
    assert result.exit_code == 2
    assert "emulated devices" in result.stderr


def test_a_simulated_robots_says_so_too(tmp_path):
    options = ("--pose", "home", "-o", tmp_path / "e.yaml", "--session", tmp_path / "e.mcap")
    assert run("calibrate", "encoder", *options).exit_code == 0
    assert load_calibration(tmp_path / "e.yaml").source == "simulated"
