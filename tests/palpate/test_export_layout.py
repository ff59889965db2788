"""`palpate export --layout`: Foxglove and PlotJuggler find every curve that the layout names."""

import json
from xml.etree import ElementTree

import pytest

from robot_io.session import Session, SessionMetadata, write_session, writer
from tests.palpate.cli import as_json, assert_refused, done, run
from tests.palpate.sessions import synthetic_session


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return synthetic_session(tmp_path_factory.mktemp("layout") / "touch.mcap")


def series_of(program, path):
    """What the layout shows, as "stream.column", with the number of a wide column's value."""
    if program == "foxglove":
        panels = json.loads(path.read_text())["configById"].values()
        return [one["value"] for panel in panels for one in panel["paths"]]
    curves = ElementTree.parse(path).getroot().iter("curve")
    return [one.get("name").replace("/", ".", 1) for one in curves]


@pytest.mark.parametrize("program", ["foxglove", "plotjuggler"])
def test_every_curve_is_a_value_of_the_session(program, session, tmp_path):
    done("export", session, "--layout", program, "-o", tmp_path / "layout")
    shown, ticks = series_of(program, tmp_path / "layout"), Session.open(session).samples("tick")
    assert {"tick.force_n", "tick.joint_position_rad[2]", "tick.phase"} <= set(shown)
    for one in shown:
        name, _, number = one.partition(".")[2].rstrip("]").partition("[")
        assert ticks.vector(name).shape[1] > int(number or 0)
        assert (number == "") == (ticks.vector(name).shape[1] == 1)


@pytest.mark.parametrize("program", ["foxglove", "plotjuggler"])
def test_of_a_long_session_the_first_value_of_each_message_is_shown(program, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "_MANY", 10)
    session = synthetic_session(tmp_path / "long.mcap")
    result = run("export", session, "--layout", program, "-o", tmp_path / "layout")
    assert "it shows every " in result.stderr
    assert {"tick.force_n[0]", "tick.joint_position_rad[2]"} <= set(series_of(program, tmp_path / "layout"))


def test_every_panel_of_foxglove_has_its_place(session, tmp_path):
    run("export", session, "--layout", "foxglove", "-o", tmp_path / "layout")
    layout = json.loads((tmp_path / "layout").read_text())

    def placed(tree):
        return [tree] if isinstance(tree, str) else placed(tree["first"]) + placed(tree["second"])

    assert placed(layout["layout"]) == list(layout["configById"])


def test_plotjuggler_stacks_its_plots(session, tmp_path):
    """Its plot_docker.cpp writes "-" for a splitter that is vertical, and "|" for plots side by side."""
    run("export", session, "--layout", "plotjuggler", "-o", tmp_path / "layout")
    (split,) = ElementTree.parse(tmp_path / "layout").getroot().iter("DockSplitter")
    assert split.get("orientation") == "-"
    assert len(split.get("sizes").split(";")) == len(split) == int(split.get("count"))


def test_without_a_name_it_lies_beside_the_session(session):
    told = as_json("export", session, "--layout", "plotjuggler")
    assert told["layout"] == str(session.with_suffix("") / "plotjuggler.xml")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--layout", "excel"), ("excel", "foxglove")),
        (("--layout", "foxglove", "--stream", "tick"), ("--stream and --layout",)),
    ],
)
def test_what_makes_no_sense_is_refused(session, options, words):
    assert_refused(run("export", session, *options), *words)


def test_a_session_without_streams_has_no_layout(tmp_path):
    path = write_session(tmp_path / "x.mcap", [], SessionMetadata())
    assert_refused(run("export", path, "--layout", "foxglove"), "no stream with anything to plot")
