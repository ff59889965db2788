"""`palpate.Study` as used in a notebook."""

import doctest

import numpy as np
import pyarrow as pa
import pytest

import palpate
import palpate.study
from palpate.robot_io.errors import InputError
from palpate.sim_backend.scenario import load_scenario
from palpate.study import Study
from tests.palpate.presses import CUBIC, press_columns, write_own_effect, write_presses


@pytest.fixture
def frame(tmp_path):
    """What a data frame library has read from somebody's file."""
    return pa.table(press_columns(write_presses(tmp_path / "p.csv")))


def test_docstring_examples_run(few_effects, without_figures):
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    result = doctest.testmod(palpate.study, optionflags=flags)
    assert result.attempted >= 12
    assert result.failed == 0


@pytest.mark.slow
def test_notebook_workflow_from_the_frame_to_the_report(few_effects, frame, tmp_path, monkeypatch):
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
    assert "are excluded from scoring: contact boundaries" in page
    assert study.export("world.yaml").left_out == ()
    world = load_scenario(tmp_path / "world.yaml")
    assert world.hidden[0].cubic_n_m3 == pytest.approx(CUBIC, rel=0.02)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.html", "world.yaml"]


def test_pandas_frame_is_read(frame):
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
    Study(path, keep=False).add("bias")
    assert len(Study(path).revisions) == 2


def test_user_effect_is_given_as_object_or_file(frame, tmp_path):
    place, space = write_own_effect(tmp_path), {}
    exec((tmp_path / "mine.py").read_text(), space)
    given = (Study(frame, effects=[one]) for one in (place, space["Mine"]()))
    errors = {study.add("mine").result.stages[-1].rmse for study in given}
    assert errors == {Study(frame).fit("contact", ["cubic_stiffness"]).rmse}


def test_package_has_no_other_name(frame):
    assert palpate.Study is Study
    with pytest.raises(AttributeError, match="no attribute 'Studies'"):
        palpate.Studies  # noqa: B018
    with pytest.raises(InputError, match="no such file"):
        Study("nowhere.csv")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return Study(write_presses(tmp_path_factory.mktemp("study") / "p.csv"), keep=False)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda s: Study(s.source, arm=3), "arm=3: give the path of a URDF"),
        (lambda s: Study(s.source, folder=3), "folder 3: give a path"),
        (lambda s: Study(s.source, effects="mine.py:Mine"), "effects='mine.py:Mine': give a list"),
        (lambda s: s.estimate(3), "estimator 3: give names"),
        (lambda s: s.estimate(["lsq", 3]), "give names"),
        (lambda s: s.estimate(runs=3), r"runs 3: give a list .* \[0, 2\]"),
        (lambda s: s.estimate(runs=[0, 0]), r"runs \[0, 0\]: a run appears twice"),
        (lambda s: s.estimate(runs=[77]), r"runs \[77\]: channel .* has no run 77"),
        (lambda s: s.add(), r"add\(\): give names of effects"),
        (lambda s: s.add(["bias"]), r"add\(\['bias'\]\): give names"),
        (lambda s: s.add("coulomb"), r"no effect is called 'coulomb'\. Did you mean .*dry_friction"),
        (lambda s: s.add("coulomb_friction"), r"not apply to any channel \(.*\)\. Did .*dry_friction"),
        (lambda s: s.add("stress_relaxtion"), r"Did you mean stress_relaxation or "),
        (lambda s: s.add("gremlin"), r"no effect is called 'gremlin'\. Effects of a contact: adhesion, "),
        (lambda s: s.compare()["nope"], "no channel 'nope' is compared. Available: contact"),
        (
            lambda s: s.remove("cubic_stiffness"),
            "'cubic_stiffness': the newest models do not have this effect; they have no added",
        ),
        (lambda s: s.export(3), "scenario 3: give a path"),
        (lambda s: s.export("x.yaml", "0"), "revisions='0': give a revision's number"),
        (lambda s: s.export("x.yaml", 7), "no revision 7"),
        (lambda s: s.report(3), "report 3: give a path"),
    ],
)
def test_invalid_arguments_are_refused(study, call, said):
    with pytest.raises(InputError, match=said):
        call(study)


def test_zero_values_are_exported(tmp_path):
    study = Study(write_presses(tmp_path / "p.csv"), keep=False)
    study.add("cubic_stiffness")
    for revision in (0, [0]):
        assert not study.export(tmp_path / "w.yaml", revision).scenario.hidden
    assert study.export(tmp_path / "w.yaml", 1).scenario.hidden
    with pytest.raises(
        InputError, match=r"'bias': the newest models do not have this effect; contact has cubic_stiffness"
    ):
        study.remove("bias")


def test_held_out_runs_judge_the_fit_to_the_others(tmp_path):
    file, effects = write_presses(tmp_path / "p.csv"), ["cubic_stiffness"]
    study = Study(file, held_out=[1, 3], keep=False)
    others = Study(file, keep=False)
    fitted, every = study.fit("contact", effects), others.fit("contact", effects)
    (channel,) = others.source.channels
    alone = Study([channel.of_runs(np.array([0, 2]))], keep=False).fit("contact", effects)
    assert fitted.values == alone.values != every.values
    left = every.data.effort - every.predict(alone.values)  # the whole measurement, by what runs 0 and 2 say
    judged = np.isfinite(every.residual) & np.isin(every.data.run, [1, 3])
    assert fitted.rmse == pytest.approx(np.sqrt(np.mean(left[judged] ** 2)), rel=0.02)
    assert set(fitted.data.run[fitted.scored]) == {1, 3}
    assert study.compare().channels[0].rmse > 3 * fitted.rmse
    parts = study.comparison(study.channel(), effects).parts
    assert {part.label for part in parts["run"]} == {"run 1", "run 3"}
    (found,) = study.estimate("lsq")
    assert found.channel.runs.tolist() == [0, 2]


def test_noise_is_that_of_the_held_out_runs(frame):
    columns = {name: frame[name].to_numpy() for name in frame.column_names}
    more = np.where(columns["run"] == 3, np.random.default_rng(1).normal(0, 0.06, len(frame)), 0)
    noisy = {**columns, "force_N": columns["force_N"] + more}
    for run, noise_n in {3: np.hypot(0.06, 0.02), 1: 0.02}.items():
        study = Study(noisy, held_out=[run])
        assert study.fit("contact", ["cubic_stiffness"]).rmse == pytest.approx(noise_n, rel=0.1)
        assert study.noise("contact").value == pytest.approx(noise_n, rel=0.1)


def test_diagnosis_judges_the_fitted_runs_by_each_other(few_effects, frame):
    columns = {name: frame[name].to_numpy() for name in frame.column_names}
    study = Study(
        {**columns, "force_N": np.where(columns["run"] == 3, 2, 1) * columns["force_N"]}, held_out=[3]
    )
    (found,) = study.diagnose().channels
    alone = Study(study.source.without([3])).compare()["contact"]
    assert found.baseline.rmse == pytest.approx(alone.rmse, rel=0.05)
    assert found.noise_floor == pytest.approx(alone.noise.value, rel=0.05)
    assert found.final.rmse < 1.1 * found.noise_floor < 0.1 * study.fit("contact", ["cubic_stiffness"]).rmse


def test_revisions_with_other_runs_held_out_are_of_other_data(tmp_path):
    file = write_presses(tmp_path / "p.csv")
    Study(file, folder=tmp_path).add("cubic_stiffness")
    held = Study(file, folder=tmp_path, held_out=[1])
    assert held.latest(held.channel()) is None
    with pytest.raises(InputError, match="other data"):
        held.add("bias", start=1)


@pytest.mark.parametrize(("cubic", "side"), [(2e6, "below"), (-1.5e6, "above")])
def test_curve_lies_below_or_above_its_straight_line_at_half_depth(tmp_path, cubic, side):
    """A spring that hardens hangs below the line through its ends, one that softens bulges above it."""
    study = Study(write_presses(tmp_path / "press.csv", cubic=cubic), model="kelvin_voigt", keep=False)
    compared = study.compare()["contact"]
    (words,) = (words for words in compared.words if words.startswith("By depth"))
    assert "N (0.00500 to 0.00750 m)" in words
    assert words.endswith(f"N {side} the model on average.")
    for parts in (compared.parts["run"], compared.parts["phase"], compared.parts["direction"]):
        assert sum(part.energy for part in parts) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "content", [None, b"", b"a,b\n1,2\n", bytes(range(256))], ids=["missing", "empty", "text", "binary"]
)
@pytest.mark.parametrize("ending", ["csv", "mcap", "npz", "parquet", "xlsx", "db3", "xyz"])
def test_error_shows_no_control_character_of_a_file_name(tmp_path, ending, content):
    path = tmp_path / f"press\x1b[31m\n\x07\u202e.{ending}"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"press\?\[31m \?\?\.") as refusal:
        Study(path)
    assert str(refusal.value).isprintable()
