import json
import shutil

import pytest

from palpate.robot_io.session import Session, write_session
from palpate.runs.robots import find_robot
from tests.log_in_process import LogInProcess
from tests.palpate.cli import assert_refused, done, run
from tests.robot_io.calibration.parts import load_calibration
from tests.robot_io.session_parts import METADATA

pytestmark = pytest.mark.usefixtures("log_in_process")
KG = (0, 1, 2, 3, 2, 1, 0)
COUNTS = [f"{1000 + 200 * kg + sample % 3},{kg}" for kg in KG for sample in range(20)]


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "cell.csv"
    path.write_text("\n".join(["reading_counts,reference_kg", *COUNTS]) + "\n")
    return path


def test_help_lists_all_commands_and_next_steps():
    result = done("calibrate", "--help")
    for word in ("force", "encoder", "torque", "gravity", "calibration: {force: force.yaml"):
        assert word in result.stdout
    assert run("calibrate").stdout == result.stdout


def test_load_cell_record_gives_calibration_file_and_plot(table, tmp_path):
    out = tmp_path / "cell.yaml"
    result = done("calibrate", "force", "--from", table, "-o", out, "--valid-days", 30)
    calibration = load_calibration(out)
    assert calibration.values.scale.unit == "N/count"
    assert calibration.values.scale.value == pytest.approx(9.80665 / 200, rel=1e-3)
    assert calibration.raw_data.file == "cell.csv"
    assert (calibration.valid_until_utc - calibration.made_utc).days == 30
    assert out.with_suffix(".html").stat().st_size > 10_000
    assert "applied" in result.stdout
    assert "A robot file cannot use it" in result.stderr
    assert "palpate calibrate force --robot follower --weights-kg" in result.stderr


def test_implausible_calibration_needs_consent(tmp_path):
    """A scale that is known to 10 % at best is not written, unless the user accepts it."""
    table, out = tmp_path / "bench.csv", tmp_path / "cell.yaml"
    rows = [
        f"{kg * 9.8 + (0.0, 6.0, -6.0, 6.0, -6.0, 6.0, -6.0)[step] + 0.01 * (sample % 3)},{kg}"
        for step, kg in enumerate(KG)
        for sample in range(20)
    ]
    table.write_text("\n".join(["reading_N,reference_kg", *rows]) + "\n")
    command = ("calibrate", "force", "--from", table, "-o", out)
    assert_refused(run(*command), "% of the range", "--accept-implausible")
    assert not out.exists()
    result = json.loads(done(*command, "--accept-implausible", "--json").stdout)
    assert any(warning.startswith("implausible: the residual is") for warning in result["warnings"])
    assert out.exists()


def test_saturation_and_drift_are_reported(tmp_path):
    table, out = tmp_path / "bench.csv", tmp_path / "cell.yaml"
    kg = (0, 0.5, 1, 2, 3, 2, 1, 0.5, 0)
    readings = [
        (min(1 + 9.8 * mass + 0.01 * (sample % 3) + 0.002 * (20 * step + sample), 25.0), mass)
        for step, mass in enumerate(kg)
        for sample in range(20)
    ]
    rows = [f"{reading},{mass}" for reading, mass in readings]
    table.write_text("\n".join(["reading_N,reference_kg", *rows]) + "\n")
    result = json.loads(done("calibrate", "force", "--from", table, "-o", out, "--json").stdout)
    saturated, drift = result["warnings"]
    assert "1 of 9 plateaus, at 29.42 N, were left out" in saturated
    assert "never shows more than 23.8 N, so set limits.force_n below" in saturated  # not 29.42 N
    assert "drifts by +0.36 N" in drift
    assert result["findings"]["drift"]["unit"] == "N"
    text = done("calibrate", "force", "--from", table, "-o", tmp_path / "again.yaml").stdout
    assert "drifts by" in text


@pytest.fixture(scope="module")
def weighing(tmp_path_factory):
    """The session of a weighing, and what the command said."""
    session = tmp_path_factory.mktemp("weighing") / "w.mcap"
    options = ("--weights-kg", "0,1,2,3,2,1,0", "--session", session, "-o", session.with_suffix(".yaml"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.runs.session.SessionWriter", LogInProcess)
        return session, json.loads(done("calibrate", "force", *options, "--json").stdout)


def test_recorded_weighing_is_evaluated_again_from_its_session(weighing, tmp_path):
    session, first = weighing
    assert first["values"]["scale"]["value"] == pytest.approx(1.0, abs=1e-3)
    assert first["raw"] == str(session)
    assert {event.kind for event in Session.open(session).events} == {"reference_force"}
    again = run("calibrate", "force", "--from", session, "--json", "-o", tmp_path / "again.yaml")
    assert json.loads(again.stdout)["values"] == first["values"]


def test_zeros_from_a_pose_move_nothing_and_a_large_shift_is_reported(tmp_path):
    session, out = tmp_path / "p.mcap", tmp_path / "p.yaml"
    result = done("calibrate", "encoder", "--pose", "home", "--session", session, "-o", out)
    assert load_calibration(out).values.offset.value == pytest.approx((0, 0, 0), abs=1e-4)
    assert not Session.open(session).samples("tick")["torque_sent_nm"].any()
    assert "check again" not in result.stdout
    assert "cp -r" in result.stderr  # what is installed is nobody's to edit
    assert "palpate probe --robot my_follower/follower.yaml" in result.stderr
    turned = ("calibrate", "encoder", "--pose", "3.05,2.7,2.8", "--from", session, "-o", tmp_path / "t.yaml")
    assert_refused(run(*turned), "joint 2: its zero is off by +4.1", "more than half a turn", "zero_rad")
    far = tmp_path / "far.yaml"
    result = done("calibrate", "encoder", "--pose", "1.5,1.5,1.5", "--from", session, "-o", far)
    assert "check again" in result.stdout
    for joint, offset in enumerate(load_calibration(far).values.offset.value, 1):
        assert (f"joint {joint} by" in result.stdout) == (abs(offset) > 0.2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("force", "--weights-kg", "0,x"), ("--weights-kg", "commas")),
        (("force", "--weights-kg", "0,1,2"), ("3 plateaus",)),
        (("force", "--weights-kg", "0,1,2,nan,2,1,0"), ("finite",)),
        (("force", "--weights-kg", "0,-1,2,3,2,-1,0"), ("--weights-kg", "not be negative")),
        (("encoder", "--pose", "1,2"), ("--pose", "2 angles", "3 joints")),
        (("encoder", "--pose", "0,0,99"), ("--pose", "joint 3", "99")),
        (("encoder", "--pose", "home", "--upper-stops", "1,1,1"), ("--pose", "--upper-stops")),
        (("encoder", "--lower-stops", "0,0,0", "--upper-stops", "1,0,1"), ("--lower-stops", "joint 2")),
        (("encoder", "--from", "x.mcap", "--lower-stops", "0,0,0"), ("--from", "--lower-stops")),
        (("torque", "--robot", "nobody"), ("nobody", "follower")),
        (("gravity", "--from", "missing.mcap"), ("missing.mcap", "no such file")),
        (("torque", "--robot", "follower", "--wire"), ("without devices",)),
    ],
)
def test_invalid_options_are_refused_in_one_line(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("calibrate", *arguments, "-o", "c.yaml"), *words)
    assert not (tmp_path / "c.yaml").exists()
    assert not (tmp_path / "c.html").exists()
    assert not (tmp_path / "sessions").exists()  # refused before anything is recorded


def test_unsuitable_session_is_refused(tmp_path):
    other = write_session(tmp_path / "probe.mcap", [], METADATA)
    for kind in ("force", "encoder", "torque", "gravity"):
        result = run("calibrate", kind, "--from", other, "-o", tmp_path / "c.yaml")
        assert_refused(result, "is from no calibration", f"palpate calibrate {kind}")
    session = tmp_path / "p.mcap"
    run("calibrate", "encoder", "--pose", "home", "--session", session, "-o", tmp_path / "p.yaml")
    result = run("calibrate", "torque", "--from", session, "-o", tmp_path / "c.yaml")
    assert_refused(result, "is from palpate calibrate encoder")
    options = ("--pose", "home", "--robot", "leader", "-o", tmp_path / "c.yaml")
    assert_refused(run("calibrate", "encoder", "--from", session, *options), "'follower', not 'leader'")
    again = ("calibrate", "encoder", "--from", session, "-o", tmp_path / "q.yaml")
    assert_refused(run(*again), "--pose")
    assert run(*again, "--pose", "home").exit_code == 0


@pytest.mark.parametrize("options", [("-o", "c.html"), ("-o", "c.yaml", "--session", "c.yaml")])
def test_colliding_output_files_are_refused(options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("calibrate", "encoder", "--pose", "home", *options), "is given twice")
    assert list(tmp_path.iterdir()) == []


def own_arm(folder):
    """A robot file whose name and folder have spaces, that names a calibration already."""
    folder.mkdir()
    for file in find_robot("follower").path.parent.glob("follower*"):
        shutil.copy(file, folder)
    robot = folder / "my arm.yaml"
    (folder / "follower.yaml").rename(robot)
    return robot


def test_existing_names_stay_in_the_robot_file_line(weighing, tmp_path, monkeypatch):
    robot = own_arm(tmp_path / "my folder")
    monkeypatch.chdir(robot.parent)
    pose = ("calibrate", "encoder", "--robot", robot.name, "--pose", "home")
    assert run(*pose, "-o", "zeros.yaml", "--session", "e.mcap").exit_code == 0
    robot.write_text(robot.read_text() + "\ncalibration: {encoder: zeros.yaml}\n")
    result = done("calibrate", "force", "--robot", robot.name, "--from", weighing[0], "-o", "cell.yaml")
    assert "  calibration: {encoder: zeros.yaml, force: cell.yaml}" in result.stderr
    assert "palpate probe --robot 'my arm.yaml'" in result.stderr


def test_refusal_leaves_no_empty_folder_and_keeps_existing_ones(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    assert_refused(run("calibrate", "encoder", "--from", "missing.mcap"), "no such file")
    assert_refused(run("calibrate", "force", "-o", "new/sub/x.yaml", "--weights-kg", "0,1"), "plateaus")
    assert_refused(run("calibrate", "force", "-o", "mine/new/x.yaml", "--weights-kg", "0,1"), "plateaus")
    assert_refused(run("probe", "--robot", "follower", "-o", "new/x.mcap", "--force-limit-n", 1e9), "force")
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]


@pytest.mark.parametrize(
    ("kind", "options", "step"),
    [
        ("force", ("--weights-kg", "0,1,2,3,2,1,0"), "palpate.commands.calibrate.fit_force"),
        ("encoder", ("--pose", "home"), "palpate.commands.calibrate.fit_encoder"),
        ("torque", (), "palpate.runs.calibration.run_motion"),
    ],
)
def test_ctrl_c_names_the_recording_even_during_analysis(kind, options, step, tmp_path, monkeypatch):
    def interrupted(*_arguments, **_options):
        (tmp_path / "whole.mcap").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(step, interrupted)
    files = ("--session", tmp_path / "whole.mcap", "-o", tmp_path / "c.yaml")
    result = run("calibrate", kind, *options, *files)
    assert result.exit_code == 130
    assert "without torque; no calibration is written" in result.stderr
    assert "whole.mcap" in result.stderr
    assert not (tmp_path / "c.yaml").exists()
