"""No device is ever told the time of a simulation."""

import re

import pytest

from palpate.runs.robots import is_simulated
from robot_io.errors import InputError
from robot_io.robot_file import parse_robot_file
from tests.palpate.cli import ROOT, assert_refused, run

SERVOS = ROOT / "robots" / "dynamixel_3dof.yaml"


@pytest.fixture
def mixed(tmp_path):
    """Real servos, and a simulated force."""
    text = SERVOS.read_text(encoding="utf-8")
    urdf = parse_robot_file(text, SERVOS).urdf_path
    text = re.sub("^urdf: .*$", f"urdf: {urdf}", text, flags=re.MULTILINE)
    text = re.sub("^dh: .*$", "", text, flags=re.MULTILINE)
    text = text.replace("encoder: {driver", "  world: {driver: pybullet}\n\nencoder: {driver", 1)
    text = re.sub(r"force: \{driver: loadstar.*\}", "force: {driver: sim_force, bus: world}", text)
    path = tmp_path / "mixed.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_robot_is_simulated_as_a_whole_or_not_at_all(mixed):
    assert not is_simulated(parse_robot_file(SERVOS.read_text(encoding="utf-8"), SERVOS))
    with pytest.raises(
        InputError, match=r"bus 'world' is simulated \(pybullet\) and bus 'motors' \(dynamixel"
    ):
        is_simulated(parse_robot_file(mixed.read_text(encoding="utf-8"), mixed))


@pytest.mark.parametrize("options", [(), ("--wire",), ("--realtime",)])
def test_real_servos_with_a_simulated_force_are_refused_before_anything_is_opened(mixed, tmp_path, options):
    out = tmp_path / "x.mcap"
    assert_refused(run("probe", "--robot", mixed, "-o", out, *options), "mixed.yaml", "'motors'", "is not")
    assert not out.exists()


def test_the_doctor_and_the_calibration_refuse_them_too(mixed, tmp_path):
    said = run("doctor", "--robot", mixed)
    assert said.exit_code == 2
    assert "bus 'world' is simulated" in said.stderr
    said = run("calibrate", "torque", "--robot", mixed, "-o", tmp_path / "c.yaml")
    assert said.exit_code == 2
    assert "bus 'world' is simulated" in said.stderr
