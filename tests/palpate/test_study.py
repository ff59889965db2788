"""`palpate.Study`, as one types it into a notebook."""

import doctest

import numpy as np
import pyarrow as pa
import pytest

import palpate
import palpate.study
from palpate.study import Study
from robot_io.errors import InputError
from sim_backend.scenario import load_scenario
from tests.palpate.presses import CUBIC, write_presses


@pytest.fixture
def frame(tmp_path):
    """What a data frame library has read from somebody's file."""
    rows = np.loadtxt(write_presses(tmp_path / "p.csv"), delimiter=",", skiprows=1)
    return pa.table(dict(zip(("time_s", "displacement_m", "force_N", "run"), rows.T, strict=True)))


def test_the_examples_in_the_docstrings_run():
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    result = doctest.testmod(palpate.study, optionflags=flags)
    assert result.attempted >= 12
    assert result.failed == 0


def test_a_notebook_from_the_frame_to_the_report(frame, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.csv").unlink()
    study = palpate.Study(frame, model="kelvin_voigt")
    assert study.compare()["contact"].lack_of_fit > 5
    (found,) = study.diagnose().channels
    assert [entry.effect for entry in found.accepted] == ["cubic_stiffness"]
    study.add("bias")
    study.add("cubic_stiffness")
    change = study.remove("bias")
    low, high = change.result.stages[-1].parameters["cubic_stiffness.k3"].interval
    assert low < CUBIC < high
    assert change.result.stages[-1].rmse == found.final.rmse
    assert [one.effects for one in study.revisions][-1] == ["cubic_stiffness"]
    figure = study.plot()
    assert any("cubic_stiffness" in str(trace) for trace in figure.data)
    page = study.report("out.html").read_text()
    assert "cubic_stiffness" in page
    assert "are not judged" in page
    assert study.export("world.yaml").left_out == ()
    world = load_scenario(tmp_path / "world.yaml")
    assert world.hidden[0].cubic_n_m3 == pytest.approx(CUBIC, rel=0.02)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.html", "world.yaml"]


def test_a_pandas_frame_is_read(frame):
    pandas = pytest.importorskip("pandas")
    columns = {name: frame[name].to_numpy() for name in frame.column_names}
    assert Study(pandas.DataFrame(columns)).channels[0].sha256 == Study(frame).channels[0].sha256


def test_notebook_and_commands_keep_revisions_in_one_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_presses(tmp_path / "p.csv")
    Study(path).add("cubic_stiffness")
    again = Study(str(path))
    assert [one.effects for one in again.revisions] == [[], ["cubic_stiffness"]]
    assert again.results()[0].added == ["cubic_stiffness"]
    assert (tmp_path / "p-palpate" / "revisions" / "0001.json").is_file()
    alone = Study(path, keep=False)
    alone.add("bias")
    assert len(Study(path).revisions) == 2


def test_an_effect_of_ones_own_is_given_as_an_object_or_by_its_file(frame, tmp_path):
    code = (
        "from estimation.effects.cubic_stiffness import CubicStiffness\n"
        "class Mine(CubicStiffness):\n    name = 'mine'\n"
    )
    file = tmp_path / "mine.py"
    file.write_text(code)
    space = {}
    exec(code, space)
    given = (Study(frame, effects=[one]) for one in (f"{file}:Mine", space["Mine"]()))
    errors = {study.add("mine").result.stages[-1].rmse for study in given}
    assert errors == {Study(frame).fit("contact", ["cubic_stiffness"]).rmse}


def test_the_package_has_no_other_name(frame):
    assert palpate.Study is Study
    with pytest.raises(AttributeError, match="no attribute 'Studies'"):
        palpate.Studies  # noqa: B018
    with pytest.raises(InputError, match="no such file"):
        Study("nowhere.csv")
