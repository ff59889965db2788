"""`palpate info`: facts of a session."""

import os

import pytest

from palpate.robot_io.session import Event, SessionMetadata, write_session
from palpate.robot_io.session.event import UNCLOSED
from tests.palpate import synthetic
from tests.palpate.cli import as_json, assert_refused, done, run
from tests.palpate.sessions import synthetic_session


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return synthetic_session(tmp_path_factory.mktemp("info") / "touch.mcap")


def test_json_states_the_facts(session):
    data = as_json("info", session)
    (stream,) = data["streams"]
    samples = len(synthetic.ticks()["time_s"])
    assert (stream["name"], stream["samples"], stream["runs"]) == ("tick", samples, 3)
    assert stream["rate_hz"] == pytest.approx(1000)
    assert data["duration_s"] == pytest.approx((samples - 1) * 0.001)
    assert (data["seed"], data["truncated"], data["dropped"]) == (7, False, 0)
    touch = {"time_s": 0.333, "kind": "touch", "text": "touched the object", "data": {"run": 0}}
    assert data["events"][0] == touch


@pytest.mark.parametrize("asked", [(), ("--json",)])
@pytest.mark.parametrize("name", ["x.mcap", os.fsdecode(b"x\xff\x1b[2J.mcap")])
def test_text_of_a_file_never_controls_the_terminal(name, asked, tmp_path):
    orders = "[/] [bold]:smile: \x1b[2J\x9b2J\x1b]0;title\x07\u202egnp\u2066\r\n\\\\\\"
    texts = {orders: orders, "source": orders, "python": orders}
    synthetic_session(tmp_path / name, command_line=orders, software_version=orders, extra=texts)
    shown = done("info", tmp_path / name, *asked).stdout
    assert all(char.isprintable() or char == "\n" for char in shown)
    assert shown.count("[bold]:smile:") >= 5  # metadata and their names
    assert "[bold]not markup" in shown  # the text of an event


def test_truncated_session_is_not_called_complete(session, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(session.read_bytes()[:-20_000])
    assert as_json("info", cut)["truncated"] is True
    assert "the end is missing" in run("info", cut).stdout
    path = tmp_path / "killed.mcap"
    write_session(path, [], SessionMetadata(), [Event(0.0, "start", "it begins"), Event(1.0, *UNCLOSED)])
    assert "no: the program was killed before it closed the file" in run("info", path).stdout
    assert as_json("info", path)["unclosed"] is True
    assert as_json("info", session)["unclosed"] is False


def test_data_file_gives_a_hint_to_import(hardening):
    assert_refused(run("info", hardening), f"palpate import {hardening}", f"palpate compare {hardening}")


def test_a_directory_is_refused_and_its_first_session_suggested(tmp_path):
    (tmp_path / "a_report.html").touch()
    refused = run("info", tmp_path)
    assert_refused(refused, "is a directory")
    assert "such as" not in refused.stderr
    for name in ("second", "first"):
        (tmp_path / f"{name}.mcap").touch()
    place = f"is a directory, not a file; name a file in it, such as {tmp_path}"
    assert_refused(run("info", tmp_path), place, "first.mcap")


def test_event_times_count_from_the_session_start(tmp_path):
    path = tmp_path / "real.mcap"
    events = [Event(50_000.25, "start", "it begins", None), Event(50_001.75, "trip", "it stops", None)]
    write_session(path, [], SessionMetadata(), events)
    said = run("info", path).stdout
    assert "0.000 s" in said
    assert "1.500 s" in said
    assert as_json("info", path)["events"][1]["time_s"] == 50_001.75


def test_most_events_are_shown_and_the_others_counted(tmp_path):
    events = [Event(float(number), "note", "again") for number in range(43)]
    shown = done("info", write_session(tmp_path / "long.mcap", [], SessionMetadata(), events)).stdout
    assert "... and 3 more (see --json)" in shown
    assert "seed       none" in shown
