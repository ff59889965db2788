"""Workbench state without a browser: choices, evidence, columns, checks, riddles, curves."""

import asyncio
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import palpate
from palpate.commands.workbench import _state
from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import read_table
from palpate.estimation.data_quality import checklist
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit import long_data
from palpate.estimation.study.source import joined, open_source
from palpate.render.effects import EffectExample, _visible_parameters, simple_motion
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Session
from palpate.study import Study
from palpate.workbench import elements
from palpate.workbench import page as page_module
from palpate.workbench.diagnosis import score_riddle
from palpate.workbench.file_drop import _options_of, _suggest_columns, _units_of
from palpate.workbench.live import run_command
from palpate.workbench.plots import MOST_POINTS, DrawnMotion, picked, time_figure
from palpate.workbench.processes import FitPrefetcher
from palpate.workbench.state import EffectEvidence, ModelSelection, WorkbenchState, evidence_of, groups
from palpate.workflows.data_options import DataArguments
from tests.palpate.presses import write_own_effect, write_presses
from tests.palpate.sessions import QUICK
from tests.palpate.test_budget import diagnosis


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    return write_presses(tmp_path_factory.mktemp("press") / "press.csv")


@pytest.fixture(scope="module")
def study(press):
    """A study whose fits are kept from test to test; no test may add a revision to it."""
    return Study(press, keep=False)


@pytest.fixture
def state(study):
    return WorkbenchState(study, "press.csv")


def test_selection_is_the_fit_that_add_makes(press):
    state = WorkbenchState(Study(press, keep=False))
    shown = state.choose(state.toggled("cubic_stiffness"))
    change = Study(press, keep=False).add("cubic_stiffness")
    assert shown.fitted.rmse == change.result.stages[-1].rmse
    assert [error for _, error in shown.steps] == [stage.rmse for stage in change.result.stages]
    assert state.save_revisions()[-1].rmse == shown.fitted.rmse


def test_preview_is_close_to_the_fit_and_skipped_for_a_known_fit(state):
    choice = state.toggled("cubic_stiffness")
    first = state.preview(choice)
    assert first.is_rough
    assert state.choice.effects == ()  # nothing is chosen by it
    fitted = state.choose(choice)
    assert not fitted.is_rough
    assert first.fitted.rmse == pytest.approx(fitted.fitted.rmse, rel=0.2)
    assert state.preview(choice) is None
    held = replace(state.toggled("delay"), held={"stiffness.k": 300.0})
    assert state.preview(held) is None  # a preview holds no parameter
    with pytest.raises(InputError, match="would contain cubic_stiffness twice"):
        state.preview(choice.with_effects(["cubic_stiffness"] * 2))


def test_undo_and_redo_go_both_ways_and_a_new_choice_ends_redo(state):
    plain_error = state.show().fitted.rmse
    state.choose(state.toggled("cubic_stiffness"))
    state.choose(state.with_held("stiffness.k", 300.0))
    assert state.undo().choice.held == {}
    assert state.undo().show().fitted.rmse == plain_error
    assert not state.can_undo
    assert state.redo().choice.effects == ("cubic_stiffness",)
    state.choose(state.toggled("cubic_stiffness"))
    assert not state.can_redo


def test_each_slider_move_is_one_step_and_leaves_the_effects(state):
    fitted = state.choose(state.toggled("cubic_stiffness")).fitted
    for value in (410.0, 420.0, 430.0):
        state.move_slider("stiffness.k", value)
    state.release()
    state.move_slider("stiffness.k", 430.0)  # said again by the browser: no step
    state.move_slider("stiffness.k", 500.0)
    state.move_slider("damping.c", 3.0)
    assert state.show().values == {**fitted.values, "stiffness.k": 500.0, "damping.c": 3.0}
    pulled = [state.undo().choice.slider_values for _ in range(3)]
    assert pulled == [{"stiffness.k": 500.0}, {"stiffness.k": 430.0}, {}]
    assert state.choice.effects == ("cubic_stiffness",)
    assert state.redo().choice.slider_values == {"stiffness.k": 430.0}
    assert state.choose(state.with_held("damping.c", 3.0)).choice.slider_values == {}
    state.move_slider("stiffness.k", 300.0)
    state.undo()
    state.move_slider("stiffness.k", 400.0)  # a step of its own after undo
    assert state.undo().choice.slider_values == {}


def test_run_selection_can_be_undone_and_ends_redo(state):
    state.choose(state.toggled("cubic_stiffness"))
    held = state.with_runs((1,), ()).with_runs((1,), (2,))
    held.choose(held.toggled("adhesion"))
    back = held.undo()
    assert (back, back.choice.effects) == (held, ("cubic_stiffness",))
    back = back.undo()
    assert (back.out, back.study.held_out) == ((1,), ())
    back = back.undo()
    assert (back.out, back.choice.effects) == ((), ("cubic_stiffness",))
    assert back.undo().choice.effects == ()
    for _ in range(3):
        back = back.redo()
    assert (back.out, back.study.held_out, back.choice.effects) == ((1,), (2,), ("cubic_stiffness",))
    back.undo()
    assert back.with_runs([1], [1, 2]).can_redo is False
    assert back.with_runs([1], [1, 2]).study.held_out == (2,)  # a run left out is not held out as well


def test_parameter_is_fixed_bounded_or_free_and_removed_with_its_effect(state):
    state.choose(state.toggled("cubic_stiffness"))
    name = "cubic_stiffness.k3"
    state.choice = state.with_bounds(name, (0.0, 2e6))
    assert state.choice.bounds == {name: (0.0, 2e6)}
    assert state.toggled("cubic_stiffness").bounds == {}
    assert state.with_held(name, None).bounds == {}
    state.choice = state.with_held(name, 1e6)
    assert (state.choice.held, state.choice.bounds) == ({name: 1e6}, {})
    assert state.toggled("cubic_stiffness").held == {}
    bounded = state.with_bounds(name, (0.0, 2e6))
    assert (bounded.held, bounded.bounds) == ({}, {name: (0.0, 2e6)})


def test_infeasible_choice_changes_nothing(state):
    before = state.choice
    with pytest.raises(InputError):
        state.choose(state.toggled("no_such_effect"))
    assert state.choice == before
    for bounds in ((2.0, 1.0), (math.nan, 1.0), (1.0, math.inf)):
        with pytest.raises(InputError, match="below"):
            state.with_bounds("stiffness.k", bounds)


@pytest.mark.parametrize(("has_user_effects", "effects"), [(False, ("cubic_stiffness",)), (True, ())])
def test_page_begins_with_the_newest_revision_unless_it_has_effects_of_its_user(
    press, monkeypatch, has_user_effects, effects
):
    newest = SimpleNamespace(effects=["cubic_stiffness"], user_effects=has_user_effects)
    monkeypatch.setattr(Study, "latest", lambda *_: newest)
    assert WorkbenchState(Study(press, keep=False)).choice.effects == effects


def test_model_that_the_diagnosis_calls_incomplete_is_marked(state, monkeypatch):
    def shown(*effects, complete=True, verdict="missing"):
        accepted = [("bias", "exact")] if verdict == "missing" else []
        known = diagnosis(accepted=accepted, verdict=verdict, complete=complete)
        monkeypatch.setattr(state.study, "known_diagnosis", lambda channel: known)
        return state.show(ModelSelection("contact", effects))

    assert [shown().is_incomplete, shown("bias").is_incomplete] == [True, False]
    assert shown("bias", complete=False).is_incomplete
    assert not shown("drift", complete=False).is_incomplete  # the diagnosis does not know this model
    assert shown(verdict="unexplained").is_incomplete
    assert not shown(verdict="adequate").is_incomplete


def test_revision_of_another_base_model_is_refused(state, press, monkeypatch):
    revision = Study(press, keep=False, model="hunt_crossley").add("cubic_stiffness").revisions[-1]
    with pytest.raises(InputError, match="starts from hunt_crossley: open the page with --model"):
        state.to_revision(revision)
    assert state.choice.effects == ()


def test_python_line_reproduces_the_page(state, press):
    assert state.undo() is state.redo() is state
    assert state.to_channel("contact").choice == state.choice
    state.choose(state.toggled("cubic_stiffness"))
    shown = state.choose(state.with_held("stiffness.k", 300.0))
    assert eval(state.python(), {"study": Study(press, keep=False)}).values == shown.fitted.values
    assert state.command() == ""
    state.undo()
    assert state.command() == (
        "palpate add press.csv cubic_stiffness --fresh --model kelvin_voigt --channel contact"
    )
    state.choice = state.with_bounds("stiffness.k", (100.0, 1000.0))
    assert state.command() == ""
    assert "bounds={'stiffness.k': (100.0, 1000.0)}" in state.python()


def test_excluded_runs_are_neither_fitted_nor_judged(state):
    whole = state.choose(state.toggled("cubic_stiffness")).fitted
    less = state.with_runs((1,), ())
    shown = less.show()
    assert 1 not in shown.fitted.data.runs
    assert shown.choice.effects == ("cubic_stiffness",)
    assert shown.fitted.values != whole.values
    assert less.command() == ""
    said = less.python().split("; ")[0].removeprefix("study = ")
    again = eval(said, {"palpate": palpate, "np": np, "study": state.study})
    assert again.fit("contact", ["cubic_stiffness"]).values == shown.fitted.values
    assert less.with_runs((), ()).show().fitted.values == whole.values
    with pytest.raises(InputError, match="at least one"):
        state.with_runs(state.channel.data.runs.tolist(), ())


def test_revisions_of_some_runs_are_saved_beside_those_of_all(press, tmp_path):
    state = WorkbenchState(Study(press, folder=tmp_path / "kept"))
    less = state.with_runs((1,), (2,))
    assert (state.use_of_runs, less.use_of_runs) == ("", " (runs left out: 1; runs held out: 2)")
    less.choose(less.toggled("bias"))
    saved = less.save_revisions()[-1]
    again = Study(press, folder=tmp_path / "kept")
    assert again.revisions[-1] == saved
    assert again.latest(again.channel("contact")) is None  # of all runs
    assert state.joined_with(press).study.folder is None


def test_held_out_runs_are_in_the_commands(state):
    state.choose(state.toggled("cubic_stiffness"))
    held = state.with_runs((0,), (2,))
    fitted = held.show().fitted
    assert set(fitted.data.run[fitted.scored]) == {2}
    assert held.python().startswith("study = palpate.Study(study.source.without([0]), held_out=[2])")
    again = state.with_runs((), (2,))
    assert again.command() == (
        "palpate add press.csv --held-out 2 cubic_stiffness --fresh --model kelvin_voigt --channel contact"
    )
    told = eval(
        again.python().split("; ")[0].removeprefix("study = "), {"palpate": palpate, "study": state.study}
    )
    assert told.fit("contact", ["cubic_stiffness"]).rmse == again.show().fitted.rmse
    assert again.with_runs((), ()).study is state.study


def test_page_states_held_out_runs_and_can_include_them(press):
    state = _state(DataArguments(file=press, held_out="2"), press, ImportOptions(), None)
    assert state.command().count("--held-out 2") == 1
    again = state.with_runs((), ())
    assert "--held-out" not in again.command()
    assert again.study.held_out == ()
    assert again.with_runs((), (2,)) is state


def test_averaged_recording_offers_no_command_for_its_runs(press, monkeypatch):
    monkeypatch.setattr(long_data, "LONG", 1000)
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", 300)
    state = WorkbenchState(Study(press, keep=False), "press.csv")
    assert state.command()
    assert not state.with_runs((), (2,)).command()


def test_equivalent_effects_are_listed_together(state):
    study, channel = state.study, state.channel
    names = ("cubic_stiffness", "power_law_stiffness", "delay")
    found = groups([evidence_of(study, channel, (), name) for name in names])
    assert [np.linalg.norm(one.change) for group in found for one in group] == pytest.approx([1.0] * 3)
    assert {one.effect for one in found[0]} == {"cubic_stiffness", "power_law_stiffness"}
    assert [one.effect for one in found[1]] == ["delay"]


def test_effect_without_influence_is_not_equivalent_to_another():
    """Its change of the residuals is parallel by chance, or nearly zero."""
    one = np.array([1.0, 0.0])
    evidence = [EffectEvidence(name, falls, one) for name, falls in (("a", 0.01), ("b", 0.5), ("c", 0.4))]
    assert [[each.effect for each in group] for group in groups(evidence)] == [["b", "c"], ["a"]]


def test_prefetched_fit_is_identical_and_requested_once(state, press):
    state = state.with_runs((), (2,))

    async def ahead():
        process = FitPrefetcher(state.study, state.channel)
        try:
            await process.fit(chain)
        finally:
            process.close()
        process._pipe = None  # neither a known fit nor an effect that the process does not have is requested
        await process.fit(chain)
        await process.fit(("mine",))

    chain = ("cubic_stiffness", "delay")
    asyncio.run(ahead())
    assert state.study.is_fitted(state.channel, chain)
    theirs, own = state.study, Study(press, keep=False, held_out=(2,))
    assert theirs.fit("contact", chain).values == own.fit("contact", chain).values
    assert np.array_equal(
        theirs.fit("contact", chain).residual, own.fit("contact", chain).residual, equal_nan=True
    )
    assert theirs.fit("contact", chain).parameters == own.fit("contact", chain).parameters


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("time_s,displacement_mm,force_N", ["time s", "displacement mm", "force N"]),
        ("t [ms],depth (mm),Fz [mN]", ["time ms", "displacement mm", "force mN"]),
        ("clock,z,load", ["time ", "displacement ", "force "]),
        ("n,angle (deg),torque [Nm]", ["time ", "position deg", "torque Nm"]),
    ],
)
def test_columns_are_guessed(tmp_path, header, expected):
    t = np.arange(0, 1, 0.01)
    path = tmp_path / "some.csv"
    np.savetxt(path, np.column_stack([t, np.sin(t), np.cos(t)]), delimiter=",", header=header, comments="")
    found = _suggest_columns(read_table(path))
    assert [f"{one.quantity} {one.unit}" for one in found] == expected
    assert all(one.unit in ("", *_units_of(one.quantity)) for one in found)
    assert all(one.why.endswith("; unit not stated") is (one.unit == "") for one in found[1:])


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("time_s,force_N,load_N", ["time s", "force N", " "]),
        ("time_s,angle,torque_2", ["time s", "position ", "torque_2 "]),
    ],
)
def test_columns_that_the_names_leave_open_are_proposed_by_name(tmp_path, header, expected):
    path, t = tmp_path / "some.csv", np.arange(0, 1, 0.01)
    np.savetxt(path, np.column_stack([t, np.sin(t), np.cos(t)]), delimiter=",", header=header, comments="")
    assert [f"{one.quantity} {one.unit}" for one in _suggest_columns(read_table(path))] == expected


@pytest.mark.parametrize(
    "header",
    [
        "Time [s],Position [mm],Extension [mm],Load [N],Torque [Nm]",
        "time [s],angle [deg],velocity [deg/s],torque [Nm],motor current [A]",
    ],
)
def test_proposed_columns_are_those_that_are_read_without_options(tmp_path, header):
    t = np.arange(0.0, 4.0, 0.01)
    depth, path = np.abs(np.sin(3.0 * t)), tmp_path / "some.csv"
    columns = np.column_stack([t, depth, 2.0 * depth, 3.0 * depth, np.cos(t)])
    np.savetxt(path, columns, delimiter=",", header=header, comments="")
    options = _options_of(_suggest_columns(read_table(path)))
    assert set(options.columns.values()) == set(import_file(path).roles)
    assert import_file(path, options).roles == import_file(path).roles


def test_corrected_quantity_keeps_the_unit_of_the_file_and_a_missing_unit_is_asked_for(tmp_path):
    """Of "Crosshead [mm]" a position was made, then a displacement in m."""
    path = tmp_path / "press.csv"
    path.write_text("Time [s],Crosshead [mm],Load\n" + "".join(f"{n / 10},{n},{n}\n" for n in range(9)))
    columns = _suggest_columns(read_table(path))
    options = _options_of(columns)
    with pytest.raises(InputError, match="states no unit"):
        Study(path, columns=options.columns, units=options.units, keep=False)
    for quantity in ("position", "", "displacement"):
        columns[1].assign(quantity)
    assert (columns[1].quantity, columns[1].unit) == ("displacement", "mm")
    columns[1].assign("force")
    assert not columns[1].unit


def test_corrected_columns_are_options_of_the_command(press):
    columns = _suggest_columns(read_table(press))
    columns[2].unit = "mN"
    options = _options_of(columns)
    assert options.units["force_N"] == "mN"
    study = Study(press, columns=options.columns, units=options.units, keep=False)
    assert np.abs(study.channels[0].data.effort).max() < 0.01
    columns[1].quantity = "force"
    with pytest.raises(InputError, match="several columns"):
        _options_of(columns)


def test_checklist_matches_the_reject_reason(study):
    data = study.channels[0].data
    assert set(checklist(data).values()) == {""}
    assert set(checklist(data)) == set(elements.GATE)
    assert "check the sign" in checklist(replace(data, effort=-data.effort))["excitation"]
    large = {name: 1e3 * getattr(data, name) for name in ("position", "velocity", "acceleration")}
    assert "millimeters" in checklist(replace(data, **large))["units"]
    flat = np.minimum(data.effort, 0.5 * data.effort.max())
    assert "is saturated" in checklist(replace(data, effort=flat))["saturation"]
    assert list(checklist(data.select(np.arange(50)))) == ["enough"]


def test_curves_are_short_and_keep_their_peaks(study):
    data = study.channels[0].data
    motion = DrawnMotion.of(data)
    rows = motion.rows(data.effort, 200)
    assert len(rows) <= 220
    assert np.nanmax(picked(data.effort, rows)) == pytest.approx(data.effort.max())
    gaps = np.flatnonzero(rows == -1)
    assert len(gaps) == len(data.runs) - 1
    assert (data.run[rows[gaps - 1]] + 1 == data.run[rows[gaps + 1]]).all()
    assert np.isnan(picked(data.effort, rows[gaps])).all()
    assert all(len(trace["x"]) <= 1.1 * MOST_POINTS for trace in time_figure(motion, None, None)["data"])
    layout = time_figure(motion, None, None)["layout"]
    low, high = (layout[name]["domain"] for name in ("yaxis2", "yaxis"))
    assert 0.0 <= low[0] < low[1] < high[0] < high[1] <= 1.0  # the residual lies below the curves
    near = motion.rows(data.effort, 200, (1.0, 1.5))
    assert np.ptp(motion.time_s[near[near >= 0]]) <= 0.5
    assert set(data.run[DrawnMotion.of(data, (2,)).rows(data.effort, 100)]) == {2}
    assert motion.rows(data.effort, 10**6, tuple(motion.time_s[[50, 60]])).tolist() == [*range(50, 61)]


@pytest.mark.parametrize("kind", list(ChannelKind))
def test_every_applicable_effect_is_visible_in_its_picture(kind):
    data, model, base = simple_motion(kind)
    names = {one.name for one in model.effects}
    for effect in (one() for name, one in EFFECTS.items() if name not in names):
        if effect.applies_to(data) and effect.gains and not effect.name.startswith("run_"):
            drawn = model.with_effect(effect).predict(data, _visible_parameters(data, model, base, effect))
            assert np.ptp(drawn - data.effort) > 0.0, effect.name


def test_form_that_needs_an_arm_is_not_drawn_on_a_plain_motion():
    swing, _, _ = simple_motion(ChannelKind.REVOLUTE)
    signals = dict.fromkeys(("tilt_effort_per_rad", "weight_effort", "payload_effort_per_kg"), swing.effort)
    of_arm = EFFECTS["gravity_tilt"]().suited_to(replace(swing, context={**swing.context, **signals}))
    assert EffectExample.on_simple_motion(of_arm, ChannelKind.REVOLUTE) is None


def test_probing_is_finished_when_the_server_leaves(tmp_path):
    path = tmp_path / "left.mcap"

    async def left():
        probing = asyncio.create_task(
            run_command(["probe", "--realtime", "--experiment", str(QUICK), "--out", str(path)], print)
        )
        while not path.exists() or path.stat().st_size < 30_000:
            assert not probing.done(), await probing
            await asyncio.sleep(0.1)
        probing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await probing

    asyncio.run(left())
    assert not Session.open(path).truncated


def test_two_measurements_are_merged_with_the_runs_of_both(press, tmp_path):
    other = write_presses(tmp_path / "more.csv", seed=9, speeds_m_s=(0.05, 0.06))
    assert len(joined(open_source(press), open_source(other)).channels[0].runs) == 6
    study = Study(joined(open_source(press), open_source(other)))
    assert study.fit("contact", ["cubic_stiffness"]).rmse == pytest.approx(0.02, rel=0.1)
    swing = {"time_s": np.arange(0, 1, 0.01), "position_rad": np.zeros(100), "torque_Nm": np.zeros(100)}
    with pytest.raises(InputError, match="no channel"):
        joined(open_source(press), open_source(swing))


def test_model_effects_and_held_out_runs_survive_a_data_change(press, tmp_path):
    own = write_own_effect(tmp_path)
    study = Study(press, "hunt_crossley", effects=[own], held_out=[2], keep=False)
    state = WorkbenchState(study, "press.csv")
    state.choose(state.toggled("mine"))
    more = write_presses(tmp_path / "more.csv", seed=9, speeds_m_s=(0.05, 0.06))
    for other in (state.joined_with(more), state.with_runs((0,), (2,))):
        assert other.channel.model.name == "hunt_crossley"
        assert other.study.held_out == (2,)
        assert other.show().steps[-1][0] == "+ mine"
    told = other.python().split("; ")[0].removeprefix("study = ")
    again = eval(told, {"palpate": palpate, "study": study})
    assert again.fit("contact", ["mine"]).rmse == other.show().fitted.rmse


@pytest.mark.parametrize(
    ("guessed", "said"),
    [({"delay"}, "You said delay: right"), ({"drift"}, "drift: wrong"), ({"lag"}, "cannot tell them apart"),
     ({"delay", "drift"}, "partly right"), (set(), "You said nothing: wrong")],
)  # fmt: skip
def test_riddle_is_scored_against_the_diagnosis(guessed, said):
    told = score_riddle({"delay"}, guessed, {"lag"}, {"lag", "delay"})
    assert said in told
    assert "cannot tell its answer from delay." in told
    alone = score_riddle(*[{"lag"}] * 4)  # an effect is not its own alternative
    assert alone.endswith("The diagnosis said lag: right.")


@pytest.mark.parametrize(
    ("is_named", "effects", "is_saved", "saves"),
    [(True, (), False, 0), (False, ("bias",), True, 0), (False, ("bias",), False, 1)],
)
def test_report_is_written_where_the_study_keeps_its_results_and_linked(
    tmp_path, monkeypatch, is_named, effects, is_saved, saves
):
    monkeypatch.chdir(tmp_path)
    said, written, saved = [], [], []
    notify = lambda text, *, html, **_: said.append((text, html))  # noqa: E731
    monkeypatch.setattr(page_module, "ui", SimpleNamespace(notify=notify))

    def report(path, commands):
        written.append(path)
        return path

    study = SimpleNamespace(
        source=SimpleNamespace(path=Path("press.csv")),
        folder=tmp_path / "mine" if is_named else None,
        report=report,
    )
    choice = ModelSelection("contact", tuple(effects))
    state = SimpleNamespace(
        study=study, choice=choice, is_saved=is_saved, command=lambda: "", use_of_runs=" (runs left out: 1)"
    )
    state.save_revisions = lambda: saved.append(True)
    home = SimpleNamespace(serve_report=str)
    shown = SimpleNamespace(state=state, _home=home, _list_revisions=lambda: None)
    asyncio.run(page_module.Page.write_report(shown))
    assert len(saved) == saves
    folder = tmp_path / "mine" if is_named else Path("press-palpate")
    assert written == [folder / "report.html"]
    link = f'<a href="{written[0]}" target="_blank">report: {written[0]}</a> (runs left out: 1)'
    assert said == [(link, True)]  # as a link that can be followed, not as its text
