"""`palpate import`, and laboratory files that are read and diagnosed without options."""

import json
import os
import shlex
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Session
from palpate.study import Study, arm_from_urdf
from tests.estimation.laboratories import (
    LABORATORIES,
    joint_log,
    one_file_a_run,
    presses,
    zwick,
)
from tests.files import saved
from tests.palpate.cli import ROOT, as_json, assert_refused, done, next_commands, run
from tests.palpate.sessions import synthetic_session

DATA = Path(os.environ.get("PALPATE_DATA", ROOT.parent / "shared" / "data"))
SOFT = DATA / "soft_indentation" / "runs.csv.gz"

GOOD = "time_s,displacement_m,force_N,run\n" + "".join(
    f"{i / 100},{i / 1e4},{i / 10},{run}\n" for run in (0, 1) for i in range(20)
)


@pytest.fixture
def good(tmp_path):
    return saved(tmp_path / "good.csv", GOOD)


def test_file_becomes_a_session(good, tmp_path):
    said = json.loads(run("import", good, "-o", tmp_path / "good.mcap", "--json").stdout)
    (channel,) = said["channels"]
    assert (channel["channel"], channel["samples"], channel["runs"]) == ("contact", 40, 2)
    session = Session.open(said["session"])
    assert session.metadata.extra["source"] == "imported from good.csv"
    assert session.samples("contact")["force_n"][19] == pytest.approx(1.9)


def test_stored_command_can_be_repeated_and_the_default_folder_is_sessions(good, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["palpate", "import", "good.csv", "--context", "room temp"])
    run("import", good, "-o", tmp_path / "good.mcap")
    kept = Session.open(tmp_path / "good.mcap").metadata.command_line
    assert shlex.split(kept) == ["palpate", "import", "good.csv", "--context", "room temp"]
    monkeypatch.chdir(tmp_path)
    result = done("import", good)
    assert [words[0] for words in next_commands(result)] == ["estimate", "compare", "diagnose", "info"]
    assert (tmp_path / "sessions" / "good.mcap").is_file()
    assert_refused(run("import", good), "already exists")


def test_import_preview_as_json_lists_the_used_columns(good, tmp_path):
    (looked,) = as_json("import", good, "--look")["files"]
    stored = as_json("import", good, "-o", tmp_path / "x.mcap")
    assert (looked["file"], looked["rows"]) == (str(good), 40)
    assert looked["columns"]["force_N"] == "force in N"
    assert {name: looked[name] for name in ("channels", "notes")} == {
        name: stored[name] for name in ("channels", "notes")
    }
    assert_refused(run("import", good, "--look", "-o", tmp_path / "y.mcap"), "--look", "--out")


def test_import_preview_shows_list_columns(tmp_path):
    rows = range(33 * 5)
    columns = {"time_s": rows, "displacement_m": rows, "force_N": rows, "tags": [["a", "b"]] * len(rows)}
    columns["run"] = np.repeat(range(33), 5)
    pa.parquet.write_table(pa.table(columns), tmp_path / "lists.parquet")
    result = done("import", tmp_path / "lists.parquet", "--look")
    assert "['a', 'b']" in result.stdout
    assert "3 more" in result.stdout


def test_session_is_not_named_like_a_table(good, tmp_path):
    for name in ("x.csv", "x"):
        assert_refused(run("import", good, "-o", tmp_path / name), "ends in .mcap", f"{tmp_path / 'x.mcap'}")
    assert list(tmp_path.iterdir()) == [good]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--column", "force_N"), ("--column", "NAME=VALUE")),
        (("--column", "force_N=load"), ("load",)),
        (("--unit", "force=parsec"), ("parsec",)),
        (("--where", "run=7"), ("run=7",)),
    ],
)
def test_bad_options_leave_nothing_behind(good, tmp_path, options, words):
    target = tmp_path / "out" / "good.mcap"
    assert_refused(run("import", good, "-o", target, *options), *words)
    assert not target.exists()


def test_unsupported_data_file_is_refused(tmp_path):
    assert_refused(run("import", tmp_path), "is a folder without a data file")
    assert_refused(run("import", tmp_path / "none.csv"), "no such file")
    assert_refused(run("import", synthetic_session(tmp_path / "s.mcap"), "--look"), "is already a session")
    (tmp_path / "empty.mcap").touch()
    assert_refused(run("import", tmp_path / "empty.mcap"), "not a palpate session")
    assert_refused(run("import", saved(tmp_path / "notes.pdf", b"%PDF")), "notes.pdf", ".csv")


@pytest.mark.skipif(not SOFT.is_file(), reason=f"measured data are not here: {SOFT}")
def test_measured_indentation_is_imported_and_estimated(tmp_path):
    session = tmp_path / "soft.mcap"
    result = run("import", SOFT, "--where", "source_file=230515_hold", "-o", session, "--json")
    assert json.loads(result.stdout)["channels"][0]["runs"] == 11
    data = as_json("estimate", session, "--estimator", "lsq")
    stiffness = data["channels"][0]["estimates"][0]["parameters"]["stiffness.k"]
    assert 50 < stiffness["value"] < 200  # the data's README finds 96 N/m on one depth of one specimen
    assert run("inspect", session, "--save", tmp_path / "soft.rrd").exit_code == 0


FOLLOWER = ROOT / "sim_backend" / "arms" / "follower" / "follower.urdf"

IDS = [one.__name__ for one in LABORATORIES]


@pytest.mark.parametrize(("write", "verdict", "truth"), [(w, *t) for w, t in LABORATORIES.items()], ids=IDS)
@pytest.mark.usefixtures("few_effects")
def test_laboratory_file_is_diagnosed_without_options(tmp_path, monkeypatch, write, verdict, truth):
    monkeypatch.chdir(tmp_path)
    result = done("diagnose", write(tmp_path), "--json")
    assert "read: " in result.stderr
    assert "time '" in result.stderr
    (channel,) = json.loads(result.stdout)["channels"]
    assert channel["verdict"] == verdict, channel["reason"]
    for name, (value, off) in truth.items():
        assert channel["final"]["parameters"][name]["value"] == pytest.approx(value, rel=off), name


def test_report_states_how_the_file_was_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("report", joint_log(tmp_path)).exit_code == 0
    page = (tmp_path / "report.html").read_text()
    assert "How the data were read" in page
    assert "results are in A, not N m" in page
    assert "Torque over position" in page


def test_import_preview_shows_columns_runs_and_phases_and_stores_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = zwick(tmp_path)
    result = run("import", path, "--look", "--runs", "2")
    for words in ("3 lines above the header", "displacement in mm", "-1,00000", "contact: 2 runs", "hold"):
        assert words in result.stdout
    assert [*tmp_path.iterdir()] == [path]
    (words,) = next_commands(result)
    assert words[0] == "import"
    assert words[-2:] == ["--runs", "2"]
    assert run(*words).exit_code == 0
    assert (tmp_path / "sessions" / "Schaum 12.mcap").is_file()


def test_effort_that_is_always_zero_is_reported(tmp_path):
    still = saved(
        tmp_path / "still.csv",
        "time_s,displacement_m,force_N\n" + "".join(f"{i / 100},{i / 1e4},0\n" for i in range(99)),
    )
    for options in (["--look"], ["-o", tmp_path / "still.mcap"]):
        result = done("import", still, *options)
        assert "contact: the effort never changes" in " ".join((result.stdout + result.stderr).split())


def test_equal_columns_of_a_folder_s_files_are_shown_once(tmp_path):
    result = run("import", one_file_a_run(tmp_path), "--look")
    assert result.stdout.count("displacement in mm") == 1
    assert result.stdout.count("contact: 1 run") == 4
    assert "only one run" not in result.stdout  # the files are four runs of one measurement


def test_import_preview_of_ambiguous_columns_asks_for_options(tmp_path):
    path = tmp_path / "two.csv"
    path.write_text("Time [s],Way [mm],A [N],B [N]\n" + "".join(f"{i},{i},{i},{-i}\n" for i in range(30)))
    result = run("import", path, "--look")
    assert result.exit_code == 2
    assert "A [N]" in result.stdout
    assert "not used" not in result.stdout
    (line,) = result.stderr.splitlines()
    assert "--column force='A [N]'" in line


def test_relaxation_shows_in_the_hold(tmp_path):
    t, x, f = presses()
    relaxed = np.where(x > 0.0, f * (0.7 + 0.3 * np.exp(-np.maximum(x, 0.0) / 1e-3)), f)
    rows = zip(t, 1e3 * x, relaxed, strict=True)
    path = tmp_path / "soft.csv"
    path.write_text("Time (s),Travel (mm),Load (N)\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    (channel,) = json.loads(run("compare", path, "--json").stdout)["channels"]
    assert {"hold", "loading", "unloading"} <= {part["label"] for part in channel["parts"]["phase"]}


def test_last_link_is_the_tip_by_default(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    urdf = saved(tmp_path / "arm.urdf", FOLLOWER.read_text().replace('"tip"', '"finger"'))
    arm = arm_from_urdf(urdf)
    assert arm.tip_frame == "finger"
    assert "so the tip is the last link, 'finger'" in arm.notes[0]
    assert arm_from_urdf(FOLLOWER).notes == ()
    assert arm_from_urdf(urdf, "hand").notes == ()
    with pytest.raises(InputError, match="no frame is called 'tip'"):
        arm_from_urdf(urdf, "tip")


@pytest.mark.parametrize("pulled", [True, False])
def test_mass_on_a_spring_is_pressed_or_pulled(pulled):
    t = np.arange(0.0, 8.0, 0.004)
    x = 3e-3 * np.sin(7.0 * t) + 1e-3 * np.sin(23.0 * t)
    v = 2.1e-2 * np.cos(7.0 * t) + 2.3e-2 * np.cos(23.0 * t)
    a = -0.147 * np.sin(7.0 * t) - 0.529 * np.sin(23.0 * t)
    force = 0.3 * a + 2.0 * v + 500.0 * x
    if not pulled:  # in free air only the mass is moved
        force = np.where(x > 0.0, force, 0.3 * a)
    force += np.random.default_rng(1).normal(0.0, 0.005, len(t))
    data = {"time_s": t, "displacement_m": x, "force_N": force}
    fitted = Study(data, model="spring_mass_damper", keep=False).fit("contact", ())
    truth = {"inertia.m": 0.3, "damping.c": 2.0, "stiffness.k": 500.0}
    assert fitted.values == pytest.approx(truth, rel=0.03)
    assert (fitted.data.touching is not None) == pulled
