"""`palpate export --stream`: what was recorded, as CSV or Parquet."""

import json

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from palpate.study import Study
from robot_io.session import Event, SessionMetadata, write_session
from tests.palpate import synthetic
from tests.palpate.cli import as_json, assert_refused, done, next_commands, run
from tests.palpate.sessions import EVENTS, synthetic_session


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return synthetic_session(tmp_path_factory.mktemp("table") / "touch.mcap")


def exported(path, name, file):
    done("export", path, "--stream", name, "-o", file)
    return pyarrow.parquet.read_table(file) if file.suffix == ".parquet" else pyarrow.csv.read_csv(file)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_stream_comes_back_to_the_last_digit(session, tmp_path, ending):
    table, ticks = exported(session, "tick", tmp_path / f"t{ending}"), synthetic.ticks()
    assert table.num_rows == len(ticks["time_s"])
    for name, values in (
        ("time_s", ticks["time_s"]),
        ("joint_position_rad_2", ticks["joint_position_rad"][:, 1]),
    ):
        np.testing.assert_array_equal(table[name].to_numpy(), values)


def test_parquet_keeps_the_units(session, tmp_path):
    table = exported(session, "tick", tmp_path / "t.parquet")
    assert table.schema.field("torque_sent_nm_3").metadata[b"unit"] == b"N m"


def test_events_are_a_table_with_their_text_as_it_is(session, tmp_path):
    table = exported(session, "events", tmp_path / "e.csv").to_pydict()
    assert table["text"] == [event.text for event in EVENTS]
    assert json.loads(table["data"][0]) == {"run": 0}


def test_of_a_session_without_a_channel_streams_and_events_are_written_too(tmp_path):
    path = write_session(tmp_path / "x.mcap", [], SessionMetadata(), [Event(0.5, "start", "it begins", None)])
    assert exported(path, "events", tmp_path / "e.csv")["time_s"].to_pylist() == [0.5]
    assert_refused(run("export", path, "--stream", "tick", "-o", tmp_path / "t.csv"), "Its streams: events")


def test_a_channel_is_imported_again_as_the_same(probed, tmp_path):
    file = tmp_path / "contact.csv"
    exported(probed[0], "contact", file)
    first, again = (Study(path, keep=False).channel("contact").data for path in (probed[0], file))
    for name in ("position", "velocity", "effort", "phase"):
        np.testing.assert_array_equal(getattr(first, name)[first.run >= 0], getattr(again, name))
    told = run("export", probed[0], "--stream", "contact", "-o", file, "--force")
    assert next_commands(told) == [["import", str(file)]]


def test_without_a_name_it_goes_where_what_is_derived_lies(session):
    told = as_json("export", session, "--stream", "tick")
    assert told["table"] == str(session.with_suffix("") / "tick.csv")
    assert "force_n" in told["columns"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--stream", "nope"), ("no stream or channel 'nope'", "events, tick")),
        (("--stream", "joint_9"), ("no stream or channel 'joint_9'", "contact, joint_1")),
        (("--stream", "tick", "-o", "x.xlsx"), ("x.xlsx", ".csv or .parquet")),
        (("--stream", "tick", "--revision", 1), ("--revision",)),
        (("--stream", "tick", "-o", "SESSION"), (".csv or .parquet",)),
    ],
)
def test_what_cannot_be_written_is_refused(session, options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(run("export", session, *(session if one == "SESSION" else one for one in options)), *words)
    assert list(tmp_path.iterdir()) == []
