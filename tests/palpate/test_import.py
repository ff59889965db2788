"""`palpate import`, also on the measurements that the README shows."""

import json
import os
import shlex
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet
import pytest

from palpate.robot_io.session import Session
from tests.palpate.cli import ROOT, as_json, assert_refused, done, next_commands, run
from tests.palpate.sessions import synthetic_session

DATA = Path(os.environ.get("PALPATE_DATA", ROOT.parent / "shared" / "data"))
SOFT = DATA / "soft_indentation" / "runs.csv.gz"

GOOD = "time_s,displacement_m,force_N,run\n" + "".join(
    f"{i / 100},{i / 1e4},{i / 10},{run}\n" for run in (0, 1) for i in range(20)
)


@pytest.fixture
def good(tmp_path):
    file = tmp_path / "good.csv"
    file.write_text(GOOD)
    return file


def test_a_file_becomes_a_session(good, tmp_path):
    result = run("import", good, "-o", tmp_path / "good.mcap", "--json")
    said = json.loads(result.stdout)
    (channel,) = said["channels"]
    assert (channel["channel"], channel["samples"], channel["runs"]) == ("contact", 40, 2)
    session = Session.open(said["session"])
    assert session.metadata.extra["source"] == "imported from good.csv"
    assert session.samples("contact")["force_n"][19] == pytest.approx(1.9)


def test_the_command_that_a_session_keeps_can_be_typed_again_and_without_a_name_goes_to_sessions(
    good, tmp_path, monkeypatch
):
    monkeypatch.setattr("sys.argv", ["palpate", "import", "good.csv", "--context", "room temp"])
    run("import", good, "-o", tmp_path / "good.mcap")
    kept = Session.open(tmp_path / "good.mcap").metadata.command_line
    assert shlex.split(kept) == ["palpate", "import", "good.csv", "--context", "room temp"]
    monkeypatch.chdir(tmp_path)
    result = done("import", good)
    assert [words[0] for words in next_commands(result)] == ["estimate", "compare", "diagnose", "info"]
    assert (tmp_path / "sessions" / "good.mcap").is_file()
    assert_refused(run("import", good), "exists already")


def test_a_look_as_json_says_what_an_import_would_take(good, tmp_path):
    (looked,) = as_json("import", good, "--look")["files"]
    stored = as_json("import", good, "-o", tmp_path / "x.mcap")
    assert (looked["file"], looked["rows"]) == (str(good), 40)
    assert looked["columns"]["force_N"] == "force in N"
    assert {name: looked[name] for name in ("channels", "notes")} == {
        name: stored[name] for name in ("channels", "notes")
    }
    assert_refused(run("import", good, "--look", "-o", tmp_path / "y.mcap"), "--look", "--out")


def test_a_look_shows_columns_of_lists(tmp_path):
    columns = {"time_s": range(9), "displacement_m": range(9), "force_N": range(9), "tags": [["a", "b"]] * 9}
    pa.parquet.write_table(pa.table(columns), tmp_path / "lists.parquet")
    result = done("import", tmp_path / "lists.parquet", "--look")
    assert "['a', 'b']" in result.stdout


def test_a_session_is_not_called_a_table(good, tmp_path):
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


def test_what_is_no_data_file_is_refused(tmp_path):
    assert_refused(run("import", tmp_path), "is a folder without a data file")
    assert_refused(run("import", tmp_path / "none.csv"), "no such file")
    assert_refused(run("import", synthetic_session(tmp_path / "s.mcap"), "--look"), "is a session already")
    (tmp_path / "empty.mcap").touch()
    assert_refused(run("import", tmp_path / "empty.mcap"), "not a palpate session")
    other = tmp_path / "notes.pdf"
    other.write_bytes(b"%PDF")
    assert_refused(run("import", other), "notes.pdf", ".csv")


@pytest.mark.skipif(not SOFT.is_file(), reason=f"measured data are not here: {SOFT}")
def test_measured_indentation_is_imported_and_estimated(tmp_path):
    session = tmp_path / "soft.mcap"
    result = run("import", SOFT, "--where", "source_file=230515_hold", "-o", session, "--json")
    assert json.loads(result.stdout)["channels"][0]["runs"] == 11
    data = as_json("estimate", session, "--estimator", "lsq")
    stiffness = data["channels"][0]["estimates"][0]["parameters"]["stiffness.k"]
    assert 50 < stiffness["value"] < 200  # the data's README finds 96 N/m on one depth of one specimen
    assert run("inspect", session, "--save", tmp_path / "soft.rrd").exit_code == 0
