"""Real drivers on emulated devices: whole runs and calibrations by commands."""

import json
import re

import pytest

from palpate.common.console import FIRST_PROBE
from palpate.estimation.data.channels import session_channels
from palpate.estimation.study.estimates import estimate_with
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.session import Session
from palpate.runs.hidden_effects import open_answer, scenario_of, truth_of
from palpate.runs.robots import EMULATED, is_simulated
from palpate.sim_backend.hidden import sealed_path
from tests.files import saved
from tests.palpate.cli import ROOT, assert_refused, done, run
from tests.palpate.sessions import QUICK
from tests.robot_io.calibration.parts import load_calibration

pytestmark = pytest.mark.usefixtures("log_in_process")
SHORT = ("--experiment", QUICK, "--online", "none")
SHARES = {  # of stiffness and damping: what each arm's steps at the tip leave uncertain
    "odrive_3dof": (0.002, 0.005),
    "cubemars_3dof": (0.003, 0.005),
    "dynamixel_3dof": (0.01, 0.03),
}
SERVOS = ROOT / "robots" / "dynamixel_3dof.yaml"


def estimates_of(path):
    contact, *_ = session_channels(Session.open(path), tared=True)
    return estimate_with(contact, "kelvin_voigt", ["lsq", "robust"]).estimates


@pytest.mark.parametrize(
    "name",
    # Of the two arms on CAN one is enough here: tests/contract compares what each of them serves.
    ["odrive_3dof", "dynamixel_3dof", pytest.param("cubemars_3dof", marks=pytest.mark.slow)],
)
def test_emulated_session_matches_the_truth(tmp_path, name):
    path = tmp_path / "wired.mcap"
    result = done("probe", "--robot", ROOT / f"robots/{name}.yaml", "--wire", "-o", path, "--seed", 3, *SHORT)
    assert "emulated devices: motors (" in result.stderr
    session = Session.open(path)
    assert session.metadata.extra["source"] == EMULATED
    assert "/dev/" in session.metadata.robot_file  # the arm's own file, not the emulators' ports
    assert parse_robot_file(session.metadata.robot_file, "session").name == name
    assert f"source     {EMULATED}" in run("info", path).stdout
    truth = truth_of(scenario_of(session))
    for estimate in estimates_of(path):
        found = {parameter.name: parameter.value for parameter in estimate.parameters}
        for key, share in zip(("stiffness.k", "damping.c"), SHARES[name], strict=True):
            assert found[key] == pytest.approx(truth[key], rel=share), estimate.estimator


@pytest.mark.parametrize("command", ["probe", "doctor"])
def test_replaced_devices_must_be_valid(tmp_path, command):
    text = SERVOS.read_text(encoding="utf-8").replace("/dev/serial/by-id/usb-Loadstar_DI-1000", "''")
    path = saved(tmp_path / "arm.yaml", text.replace("dynamixel_3dof.", f"{SERVOS.parent}/dynamixel_3dof."))
    refused = run(command, "--robot", path, "--wire")
    assert_refused(refused, "buses.load_cell.port: string should have at least 1 character")


@pytest.mark.slow
def test_arm_without_torque_mode_estimates_a_stiffness(tmp_path):
    """SO-101, as docs/tutorial/so101.md has it."""
    path = tmp_path / "so101.mcap"
    plan = ("--scenario", "soft", "--speed-mm-s", "20,10", "--force-limit-n", 3, "--online", "none")
    done("probe", "--robot", ROOT / "robots/so101.yaml", "--wire", "-o", path, *plan)
    for estimate in estimates_of(path):
        found = {parameter.name: parameter.value for parameter in estimate.parameters}
        assert found["stiffness.k"] == pytest.approx(200.0, rel=0.015)
        assert found["damping.c"] == pytest.approx(10.0, rel=0.06)


def test_invalid_wire_options_are_refused(tmp_path):
    path = tmp_path / "no.mcap"
    assert_refused(run("probe", "--wire", "-o", path), "follower", "without devices")
    assert not path.exists()
    path = tmp_path / "no.mcap"
    robot = ROOT / "robots/odrive_3dof.yaml"
    assert_refused(run("probe", "--robot", robot, "--scenario", "stiff", "-o", path), "--wire")
    assert not path.exists()


@pytest.fixture
def mixed(tmp_path):
    """Real servos, and a simulated force."""
    text = SERVOS.read_text(encoding="utf-8")
    urdf = parse_robot_file(text, SERVOS).urdf_path
    text = re.sub("^urdf: .*$", f"urdf: {urdf}", text, flags=re.MULTILINE)
    text = re.sub("^dh: .*$", "", text, flags=re.MULTILINE)
    text = text.replace("encoder: {driver", "  world: {driver: pybullet}\n\nencoder: {driver", 1)
    text = re.sub(r"force: \{driver: loadstar.*\}", "force: {driver: sim_force, bus: world}", text)
    return saved(tmp_path / "mixed.yaml", text)


def test_robot_is_simulated_as_a_whole_or_not_at_all(mixed):
    assert not is_simulated(parse_robot_file(SERVOS.read_text(encoding="utf-8"), SERVOS))
    with pytest.raises(InputError, match=r"'world' is simulated \(pybullet\) and bus 'motors' \(dyn"):
        is_simulated(parse_robot_file(mixed.read_text(encoding="utf-8"), mixed))


@pytest.mark.parametrize("options", [(), ("--wire",), ("--realtime",)])
def test_real_servos_with_a_simulated_force_are_refused_before_opening(mixed, tmp_path, options):
    out = tmp_path / "x.mcap"
    assert_refused(run("probe", "--robot", mixed, "-o", out, *options), "mixed.yaml", "'motors'", "is not")
    assert not out.exists()


def test_doctor_and_calibration_refuse_mixed_robots_too(mixed, tmp_path):
    said = run("doctor", "--robot", mixed)
    assert said.exit_code == 2
    assert "bus 'world' is simulated" in said.stderr
    said = run("calibrate", "torque", "--robot", mixed, "-o", tmp_path / "c.yaml")
    assert said.exit_code == 2
    assert "bus 'world' is simulated" in said.stderr


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A robot file of real drivers that names a calibration made with --wire."""
    folder = tmp_path_factory.mktemp("wired")
    shipped = (ROOT / "robots/odrive_3dof.yaml").read_text()
    path = folder / "arm.yaml"
    path.write_text(shipped.replace("urdf: ..", f"urdf: {ROOT}").replace("dh: ..", f"dh: {ROOT}"))
    out = folder / "e.yaml"
    options = ("--wire", "--pose", "home", "-o", out, "--session", folder / "e.mcap")
    result = done("calibrate", "encoder", "--robot", path, *options)
    assert "a real arm refuses it" in result.stderr
    assert f"palpate probe --robot {path} --wire {FIRST_PROBE}" in result.stderr
    assert "once the robot file names it" in result.stderr
    path.write_text(path.read_text() + "\ncalibration: {encoder: e.yaml}\n")
    return path


def test_emulated_calibration_states_its_source(arm):
    assert load_calibration(arm.parent / "e.yaml").source == "emulated"


@pytest.mark.parametrize("command", [("probe",), ("calibrate", "torque")], ids=" ".join)
def test_emulated_calibration_is_refused_by_the_real_arm(arm, command, tmp_path):
    result = run(*command, "--robot", arm, "-o", tmp_path / "x.mcap", "--yes")
    assert_refused(result, "calibration.encoder", "'e.yaml'", "emulated devices", "palpate calibrate encoder")


def test_emulated_devices_accept_it_and_hide_effects(arm, tmp_path):
    path = tmp_path / "secret.mcap"
    wired = ("probe", "--robot", arm, "--wire", "-o", path, "--seed", 4, *SHORT)
    said = json.loads(done(*wired, "--hidden", "cubic_stiffness", "--json").stdout)
    assert "encoder" in run("info", path, "--json").stdout
    session = Session.open(path)
    assert said["sealed"] == str(sealed_path(path))
    assert "cubic" not in session.metadata.scenario + session.metadata.command_line
    (effect,) = open_answer(session).hidden
    assert effect.name == "cubic_stiffness"


def test_doctor_accepts_it_with_emulated_devices(arm):
    assert run("doctor", "--robot", arm, "--wire").exit_code == 0
    result = run("doctor", "--robot", arm)
    assert result.exit_code == 2
    assert "emulated devices" in result.stderr


def test_simulated_calibration_states_its_source(tmp_path):
    options = ("--pose", "home", "-o", tmp_path / "e.yaml", "--session", tmp_path / "e.mcap")
    assert run("calibrate", "encoder", *options).exit_code == 0
    assert load_calibration(tmp_path / "e.yaml").source == "simulated"
