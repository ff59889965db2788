"""`palpate probe --wire`: a whole run through the real drivers, as a user starts it."""

import json

import pytest

from estimation.data import session_channels
from estimation.study.estimates import estimate_with
from palpate.arm.hiding import open_answer
from palpate.arm.wired import EMULATED
from palpate.truth import true_parameters
from robot_io.robot_file import parse_robot_file
from robot_io.session import Session
from sim_backend.secret import sealed_path
from tests.palpate.cli import ROOT, assert_refused, run

SHORT = ("--speed-mm-s", "150,60", "--hold-s", 0.5)
SHARES = {  # of stiffness and damping: what each arm's steps at the tip leave uncertain
    "odrive_3dof": (0.002, 0.005),
    "cubemars_3dof": (0.003, 0.005),
    "dynamixel_3dof": (0.01, 0.03),
}


def estimates_of(path):
    contact, *_ = session_channels(Session.open(path), tared=True)
    return estimate_with(contact, "kelvin_voigt", ["lsq", "robust"]).estimates


@pytest.mark.parametrize("name", SHARES)
def test_a_session_over_the_wire_tells_the_truth(tmp_path, name):
    path = tmp_path / "wired.mcap"
    result = run("probe", "--robot", ROOT / f"robots/{name}.yaml", "--wire", "-o", path, "--seed", 3, *SHORT)
    assert result.exit_code == 0, result.stderr
    assert "emulated devices: motors (" in result.stderr
    session = Session.open(path)
    assert session.metadata.extra["source"] == EMULATED
    assert "/dev/" in session.metadata.robot_file  # the arm's own file, not the emulators' ports
    assert parse_robot_file(session.metadata.robot_file, "session").name == name
    assert f"source     {EMULATED}" in run("info", path).stdout
    truth = true_parameters(session)
    for estimate in estimates_of(path):
        found = {parameter.name: parameter.value for parameter in estimate.parameters}
        for key, share in zip(("stiffness.k", "damping.c"), SHARES[name], strict=True):
            assert found[key] == pytest.approx(truth[key], rel=share), estimate.estimator


def test_effects_can_be_hidden_behind_the_wire(tmp_path):
    path = tmp_path / "secret.mcap"
    robot = ROOT / "robots/odrive_3dof.yaml"
    quick = ("--speed-mm-s", 150, "--hold-s", 0.1)
    wired = ("probe", "--robot", robot, "--wire", "-o", path, "--seed", 4)
    result = run(*wired, "--hidden", "cubic_stiffness", "--json", *quick)
    assert result.exit_code == 0, result.stderr
    said, metadata = json.loads(result.stdout), Session.open(path).metadata
    assert said["sealed"] == str(sealed_path(path))
    assert "cubic" not in metadata.scenario + metadata.command_line
    (effect,) = open_answer(Session.open(path)).hidden
    assert effect.name == "cubic_stiffness"


def test_a_robot_without_wires_is_refused(tmp_path):
    path = tmp_path / "no.mcap"
    assert_refused(run("probe", "--wire", "-o", path), "follower", "without wires")
    assert not path.exists()


def test_a_scenario_for_real_devices_is_refused_with_the_way_out(tmp_path):
    path = tmp_path / "no.mcap"
    robot = ROOT / "robots/odrive_3dof.yaml"
    assert_refused(run("probe", "--robot", robot, "--scenario", "stiff", "-o", path), "--wire")
    assert not path.exists()
