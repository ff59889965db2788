"""What `palpate info` says about a session."""

import os

import pytest

from palpate.robot_io.session import Event, SessionMetadata, write_session
from palpate.robot_io.session.event import unclosed
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
    assert data["events"][0] == {
        "time_s": 0.333,
        "kind": "touch",
        "text": "touched the object",
        "data": {"run": 0},
    }


def test_text_of_a_file_cannot_command_the_terminal(session):
    shown = run("info", session).stdout
    assert "\x1b[2J" not in shown
    assert "[bold]not markup" in shown


@pytest.mark.parametrize("asked", [(), ("--json",)])
@pytest.mark.parametrize("name", ["x.mcap", os.fsdecode(b"x\xff\x1b[2J.mcap")])
def test_no_text_of_a_file_commands_the_terminal(name, asked, tmp_path):
    orders = "[/] [bold]:smile: \x1b[2J\x9b2J\x1b]0;title\x07\u202egnp\u2066\r\n\\\\\\"
    texts = {orders: orders, "source": orders, "python": orders}
    synthetic_session(tmp_path / name, command_line=orders, software_version=orders, extra=texts)
    shown = done("info", tmp_path / name, *asked)
    assert all(char.isprintable() or char == "\n" for char in shown.stdout)
    assert shown.stdout.count("[bold]:smile:") >= 5


def test_a_session_cut_short_or_whose_program_was_killed_is_not_called_whole(session, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(session.read_bytes()[:-20_000])
    assert as_json("info", cut)["truncated"] is True
    assert "the end is missing" in run("info", cut).stdout
    path = tmp_path / "killed.mcap"
    write_session(path, [], SessionMetadata(), [Event(0.0, "start", "it begins", None), unclosed(1.0)])
    assert "no: the program was killed before it closed the file" in run("info", path).stdout
    assert as_json("info", path)["unclosed"] is True
    assert as_json("info", session)["unclosed"] is False


@pytest.mark.parametrize("content", [b"", b"time_s,force_N\n0,1\n", bytes(range(256)) * 50])
def test_what_is_no_session_is_refused(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    assert_refused(run("info", path), "other.mcap")


def test_of_a_data_file_it_is_said_how_to_import_it(hardening):
    assert_refused(run("info", hardening), f"palpate import {hardening}", f"palpate compare {hardening}")


def test_a_directory_is_refused(tmp_path):
    assert_refused(run("info", tmp_path), "is a directory")
    (tmp_path / "second.mcap").touch()
    (tmp_path / "first.mcap").touch()
    assert_refused(
        run("info", tmp_path), f"is a directory, not a file; name a file in it, such as {tmp_path}"
    )
    assert_refused(run("info", tmp_path), "first.mcap")


def test_in_a_directory_only_a_session_is_suggested(tmp_path):
    (tmp_path / "a_report.html").touch()
    refused = run("info", tmp_path)
    assert_refused(refused, "is a directory")
    assert "such as" not in refused.stderr
    (tmp_path / "b.mcap").touch()
    assert_refused(run("info", tmp_path), "b.mcap")


def test_events_are_told_from_the_start_and_not_from_the_machines(tmp_path):
    path = tmp_path / "real.mcap"
    events = [Event(50_000.25, "start", "it begins", None), Event(50_001.75, "trip", "it stops", None)]
    write_session(path, [], SessionMetadata(), events)
    said = run("info", path).stdout
    assert "0.000 s" in said
    assert "1.500 s" in said
    assert as_json("info", path)["events"][1]["time_s"] == 50_001.75


def test_names_in_a_session_s_metadata_are_shown_and_not_obeyed(tmp_path):
    path = tmp_path / "foreign.mcap"
    write_session(path, [], SessionMetadata(extra={"[red]key\x1b[2J": "value"}))
    said = done("info", path)
    assert "[red]key" in said.stdout
    assert "\x1b" not in said.stdout
