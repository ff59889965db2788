"""`palpate merge`: several sessions as one measurement."""

import re

import numpy as np
import pytest

from palpate.robot_io.session import Column, Session, SessionMetadata, Stream, write_session
from palpate.study import Study
from tests.palpate import synthetic
from tests.palpate.cli import as_json, assert_refused, done, run
from tests.palpate.presses import write_presses
from tests.palpate.sessions import EVENTS, synthetic_session


@pytest.fixture(scope="module")
def probings(tmp_path_factory):
    folder, sealed = tmp_path_factory.mktemp("probings"), {"seal": "5" * 32}
    names = (("a", 1), ("b", 2))
    return [synthetic_session(folder / f"{name}.mcap", seed=seed, extra=sealed) for name, seed in names]


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    folder, files = tmp_path_factory.mktemp("imported"), []
    for seed in (1, 2):
        data = write_presses(folder / f"{seed}.csv", cubic=0, seed=seed)
        files.append(folder / f"{seed}.mcap")
        assert run("import", data, "-o", files[-1]).exit_code == 0
    return files


def merged(files, path):
    return as_json("merge", *files, "-o", path)


def test_merged_runs_continue_without_loss_and_metadata_hold_for_all(probings, tmp_path):
    told = merged(probings, tmp_path / "both.mcap")
    both, ticks = Session.open(tmp_path / "both.mcap"), synthetic.ticks()
    assert told["samples"] == {"tick": 2 * len(ticks["time_s"])}
    tick = both.samples("tick")
    np.testing.assert_array_equal(np.unique(tick["run"]), np.arange(6))
    np.testing.assert_array_equal(tick["force_n"], np.tile(ticks["force_n"], 2))
    assert [event.text for event in both.events] == [event.text for event in EVENTS] * 2
    metadata = both.metadata
    assert metadata.seed is None
    assert metadata.urdf == synthetic.urdf()
    assert metadata.extra["source"] == "merged from a.mcap, b.mcap"
    assert "seal" not in metadata.extra  # the mark of a sealed answer belongs to its own session


def test_merged_session_equals_the_folder_of_sessions(probings, tmp_path):
    merged(probings, tmp_path / "both.mcap")
    one, other = (
        {each.name: each for each in Study(path, "kelvin_voigt", keep=False).channels}
        for path in (tmp_path / "both.mcap", probings[0].parent)
    )
    assert {name: each.sha256 for name, each in one.items()} == {
        name: each.sha256 for name, each in other.items()
    }


def test_imported_sessions_are_merged_too(imported, tmp_path):
    merged(imported, tmp_path / "both.mcap")
    study = Study(tmp_path / "both.mcap", keep=False)
    assert study.channel().data.runs.tolist() == list(range(8))
    assert study.fit("contact").parameters["stiffness.k"].value == pytest.approx(400.0, rel=0.01)


@pytest.mark.parametrize(
    ("offset_m", "stiffness", "said"),
    [
        (0.0, 400.0, ""),
        (0.0, 800.0, ""),
        (0.002, 400.0, r"other.mcap: contact begins about 2(\.\d)? mm deeper"),
    ],
)
def test_surface_at_another_depth_is_reported(imported, tmp_path, offset_m, stiffness, said):
    def law(x, v):
        return stiffness * np.maximum(x - offset_m, 0.0)

    other = write_presses(tmp_path / "other.csv", force_of=law)
    run("import", other, "-o", tmp_path / "other.mcap")
    result = done("merge", imported[0], tmp_path / "other.mcap", "-o", tmp_path / "both.mcap")
    told = " ".join(result.stderr.split())
    assert re.search(said, told) if said else "begins" not in told


def test_merged_session_lasts_as_long_as_its_parts(imported, probings, tmp_path):
    for number, files in enumerate((imported, probings)):
        merged(files, tmp_path / f"{number}.mcap")
        lasts = [as_json("info", f)["duration_s"] for f in (tmp_path / f"{number}.mcap", *files)]
        assert lasts[0] == pytest.approx(sum(lasts[1:]))


def test_truncated_session_is_named(imported, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(imported[1].read_bytes()[:-2000])
    told = run("merge", imported[0], cut, "-o", tmp_path / "both.mcap").stderr
    assert "cut.mcap: is incomplete" in told
    assert f"{imported[0].name}: is" not in told
    both, again = tmp_path / "both.mcap", tmp_path / "again.mcap"
    merged([both, imported[0]], again)
    for file, lacking in ((both, "cut.mcap"), (again, "both.mcap"), (imported[0], "")):
        complete = re.search(r"complete +(.*)", run("info", file).stdout)[1]
        assert complete == (f"no: merged from incomplete sessions: {lacking}" if lacking else "yes")


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("A",), ("one session", "two or more")),
        (("A", "A"), ("given twice",)),
        (("A", "copy.mcap"), ("copy.mcap: is a copy of", "a.mcap; its runs would count")),
        (("A", "ARM"), ("not recorded with the arm of",)),
        (("A", "IMPORTED"), ("was not recorded with an arm, but", "a.mcap was;")),
        (("IMPORTED", "A"), ("a.mcap: was recorded with an arm, but", "was not;")),
        (("PLAIN", "WIDER"), ("stream 'extra' differs from the one in", "in columns width")),
        (("PLAIN", "IMPORTED"), ("has streams contact",)),
        (("A", "none.mcap"), ("no such file",)),
        (("A", "circle.mcap"), ("circle.mcap: no such file",)),
    ],
)
def test_incompatible_sessions_are_refused(names, words, probings, imported, tmp_path):
    def session(name, **columns):
        stream = Stream("extra", tuple(Column(one, "1", width) for one, width in columns.items()))
        arrays = {
            one: np.zeros((3, width)) if width > 1 else np.arange(3.0) for one, width in columns.items()
        }
        return write_session(tmp_path / name, [(stream, arrays)], SessionMetadata())

    files = {"A": probings[0], "IMPORTED": imported[0], "none.mcap": tmp_path / "none.mcap"}
    files["circle.mcap"] = tmp_path / "circle.mcap"
    files["circle.mcap"].symlink_to("circle.mcap")
    files["copy.mcap"] = tmp_path / "copy.mcap"
    files["copy.mcap"].write_bytes(probings[0].read_bytes())
    files["ARM"] = synthetic_session(tmp_path / "arm.mcap", urdf="<robot name='r'/>")
    files["PLAIN"] = session("plain.mcap", time_s=1, width=1)
    files["WIDER"] = session("wider.mcap", time_s=1, width=2)
    assert_refused(run("merge", *(files[name] for name in names), "-o", tmp_path / "out.mcap"), *words)
    assert not (tmp_path / "out.mcap").exists()
