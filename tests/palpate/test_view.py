"""View model: verdict, thinned curves, residual maps, names of speeds."""

import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from palpate.control.loop.task import Phase
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.design.next_experiment import propose_remedial_experiment
from palpate.estimation.diagnosis import ChannelDiagnosis
from palpate.estimation.diagnosis.result import NoiseFloor, ParameterValue
from palpate.render import palette, terminal
from palpate.render.build import _as_estimate, _run_speeds, channel_view, concatenated_times
from palpate.render.diagnosis import describe_error_decrease, diagnosis_verdict
from palpate.render.thinning import join_curves, peak_rows, rows_by_run, run_curves
from palpate.render.view import StudyView, residual_map
from tests.palpate import synthetic

STEP = {"parameters": {}, "p_value": 0.005, "physics": "p", "equation": "e", "signature": "s"}


def accepted(effect, before, after, *rivals):
    return {**STEP, "effect": effect, "rmse_before": before, "rmse_after": after, "confused_with": rivals}


def diagnosis(verdict, *steps, after=0.1, floor=0.1, means=(None, None), **more):
    base = {"rmse": 0.5, "parameters": {}, "rmse_of_means": means[0], "samples_per_mean": 10}
    about = {"channel": "contact", "reason": "r", "effort_unit": "N", "noise_floor": floor}
    about["floor"] = NoiseFloor(value=floor, source="free air", at_most=False, free_air=floor, share_left=0.0)
    final = base | {"rmse": after, "rmse_of_means": means[1]}
    return ChannelDiagnosis(
        verdict=verdict, accepted=list(steps), baseline=base, final=final, **{**about, **more}
    )


ONE, TWO = accepted("bias", 0.5, 0.2), accepted("lag", 0.2, 0.1, "delay", "damping")


@pytest.mark.parametrize(
    ("found", "words", "absent"),
    [
        (
            diagnosis("adequate", after=0.102),
            ("show no missing effect", "runs is 0.102 N (noise 0.100 N, from free air)"),
            (),
        ),
        (diagnosis("insufficient", reason="only one run"), ("possible: only one run.",), ("error",)),
        (
            diagnosis(
                "insufficient",
                reason="no contact; press it",
                next_experiment=propose_remedial_experiment("no contact; press it", ChannelKind.CONTACT),
            ),
            ("possible: no contact.",),  # the remedy is shown as the next experiment
            ("press it",),
        ),
        (diagnosis("insufficient", reason="which?"), ("possible: which?",), ("?.",)),
        (
            diagnosis("missing", ONE, TWO),
            ("bias and lag (or delay or damping) are missing", "With them", "falls from 0.500 to 0.100 N"),
            ("error remains",),
        ),
        (diagnosis("missing", ONE, after=0.2), ("bias is missing", "With it"), ("are missing",)),
        (diagnosis("missing", ONE, after=0.495), ("stays at 0.495 N",), ("falls",)),
        (diagnosis("missing", ONE, after=0.495, means=(0.4, 0.399)), ("stays at 0.495 N",), ("falls",)),
        (
            diagnosis("missing", ONE, after=0.495, means=(0.4, 0.1)),
            ("stays at 0.495 N", "Averaged over 10 samples", "it falls from 0.400 to 0.100 N"),
            (),
        ),
        (
            diagnosis("unexplained", depends_on=["a", "b"]),
            ("something is missing that no known effect explains; it depends on a and b",),
            (),
        ),
        (diagnosis("unexplained"), ("it depends on no single signal",), ()),
    ],
)
def test_verdict_is_one_sentence(found, words, absent):
    told = diagnosis_verdict(found).sentence
    assert all(word in told for word in words)
    assert not any(word in told for word in absent)


@pytest.mark.parametrize(
    ("complete", "at_most", "times", "words"),
    [
        (True, False, 1.2, "(noise 0.100 N, from free air)."),
        (True, False, 1.8, "The remaining error, 1.8 times the noise, depends on no recorded signal."),
        (False, False, 1.8, "An unexplained error of 1.8 times the noise remains and depends on a."),
        (False, False, 361.9, "An unexplained error of 360 times the noise remains and depends on a."),
        (False, True, 0.9, "The remaining error may be noise, but depends on a."),
        (False, True, 1.8, "An unexplained error of at least 1.8 times the noise remains and depends on a."),
    ],
)
def test_accepted_effect_is_named_for_complete_and_incomplete_models(complete, at_most, times, words):
    rest = SimpleNamespace(rmse=0.1 * times, times_floor=times, depends_on=["a"])
    known = dict(diagnosis("missing", after=0.18))
    known["accepted"] = [SimpleNamespace(form="exact", **ONE)]
    known["floor"] = known["floor"].model_copy(update={"at_most": at_most})
    found = SimpleNamespace(**known | {"complete": complete, "remaining": rest})
    told = diagnosis_verdict(found).sentence
    assert "bias is missing from the base model." in told
    assert told.endswith(words)


@pytest.mark.parametrize(
    ("errors", "is_bound", "words"),
    [
        ((0.0871, 0.01035, 0.01035), False, "second, hardly reduces the error: from 0.01035 to 0.01035 N."),
        (
            (0.0871, 0.01035, 0.02),
            False,
            "last step, second, increases the error: from 0.01035 to 0.02000 N.",
        ),
        ((0.0871, 0.05, 0.01), False, "down to the noise."),
        ((0.0871, 0.03), False, "3.0 times the noise."),
        ((0.0871, 0.0870), False, "does not fall (0.0871 before, 0.0870 N now)."),
        ((0.3, 0.01), True, "which may be noise."),
        ((0.3, 0.02), True, "to at least 2.0 times the noise."),
    ],
)
def test_last_step_is_credited_only_with_its_own_decrease(errors, is_bound, words):
    added = ["first", "second"][: len(errors) - 1]
    told = describe_error_decrease("contact", errors, added, 0.01, "N", is_bound=is_bound)
    assert told.endswith(words)
    assert told.startswith(f"contact with {' and '.join(added)}: the error in held-out runs")


@pytest.mark.parametrize("n", [10, 5000, 60_001])
def test_peaks_survive_thinning(n):
    values = np.sin(np.linspace(0.0, 40.0, n))
    values[n // 3], values[n // 2] = 9.0, -7.0
    rows = peak_rows(values, 1000)
    assert len(rows) <= 1002
    assert (rows[0], rows[-1]) == (0, n - 1)
    assert {n // 3, n // 2} <= set(rows.tolist())


def test_excluded_stretch_stays_a_gap():
    values = np.ones(20_000)
    values[5000:9000] = np.nan
    rows = peak_rows(values, 400)
    between = (rows > 5100) & (rows < 8900)
    assert between.any()
    assert np.isnan(values[rows[between]]).all()
    assert np.isfinite(values[rows[rows < 5000]]).all()


def test_many_runs_are_represented_by_a_few_and_never_joined():
    rows = rows_by_run(np.repeat(np.arange(2000), 10))
    assert len(rows) == 60
    assert {0, 1999} <= set(rows)
    x, y = join_curves(run_curves(np.arange(20_000.0), np.ones(20_000), list(rows.values())))
    assert np.isnan(y).sum() == 60
    assert np.nanmax(np.diff(x)[np.isfinite(np.diff(x))]) == 1.0


@pytest.fixture(scope="module")
def contact():
    ticks = synthetic.ticks()
    depth = synthetic.SURFACE_M - ticks["tip_position_world_m"][:, 2]
    speed = -ticks["tip_velocity_world_m_s"][:, 2]
    acceleration = np.gradient(speed, synthetic.PERIOD_S)
    about = (ticks["force_n"], ticks["run"], ticks["phase"])
    return ChannelData("contact", ChannelKind.CONTACT, ticks["time_s"], depth, speed, acceleration, *about)


def test_runs_are_named_by_speed_from_slow_to_fast(contact):
    assert _run_speeds(contact) == {2: "60 mm/s", 1: "90 mm/s", 0: "150 mm/s"}
    strain = replace(contact, proxy_units={"position": "strain"})
    assert _run_speeds(strain) == {2: "0.06 strain/s", 1: "0.09 strain/s", 0: "0.15 strain/s"}
    assert _run_speeds(contact.select(contact.run == 0)) == {}
    assert list(_run_speeds(replace(contact, phase=np.full(len(contact), -1)))) == [2, 1, 0]
    nearly = np.where(contact.run == 1, 0.98 * 150 / 90, 1.0) * contact.velocity
    words = _run_speeds(replace(contact, velocity=nearly))
    assert words[0] == words[1] != words[2]


@pytest.mark.parametrize("is_known", [True, False])
def test_a_press_that_accelerates_until_the_touch_is_named_by_its_own_speed(is_known):
    speeds_mm_s, step_s = (90, 60, 30, 15, 5), 0.002
    runs, phases, velocities = [], [], []
    for run, speed in enumerate(speeds_mm_s):
        moving_s = 5 / speed  # 5 mm of loading after an approach that accelerates, then a hold that trembles
        parts = [
            np.linspace(0, speed, 20),
            np.full(round(moving_s / step_s), speed),
            3 * np.sin(np.arange(5000)),
        ]
        velocities += parts
        phases += [np.full(len(part), phase) for part, phase in zip(parts, (2, 3, 4), strict=True)]
        runs.append(np.full(sum(map(len, parts)), run))
    run, phase, velocity = map(np.concatenate, (runs, phases, velocities))
    if not is_known:
        run, velocity = run[phase != Phase.HOLD], velocity[phase != Phase.HOLD]
        phase = np.full(len(run), -1)
    zero = np.zeros(len(run))
    data = ChannelData(
        "contact",
        ChannelKind.CONTACT,
        step_s * np.arange(len(run)),
        zero,
        velocity / 1e3,
        zero,
        zero,
        run,
        phase,
    )
    assert _run_speeds(data) == {i: f"{speed:.2g} mm/s" for i, speed in enumerate(speeds_mm_s)}


def test_runs_that_each_begin_at_zero_are_shown_in_sequence(contact):
    starts = np.array([contact.time_s[contact.run == run][0] for run in contact.runs])
    again = replace(contact, time_s=contact.time_s - starts[contact.run])
    assert (np.diff(concatenated_times(again)) > 0.0).all()


def test_residual_map_averages_scored_samples_in_a_cell(contact):
    judged = contact.position < 0.01
    view = channel_view(contact, (), None, scored=judged)
    used = view.engaged & view.scored
    flat = residual_map(view.position, view.velocity, np.where(judged, 0.3, 99.0), used)
    seen = flat.mean[np.isfinite(flat.mean)]
    assert len(seen) > 8
    np.testing.assert_allclose(seen, 0.3)
    signs = residual_map(view.position, view.velocity, np.sign(contact.velocity), used)
    assert np.nanmin(signs.mean[signs.velocity > 5.0]) == 1.0
    assert np.nanmax(signs.mean[signs.velocity < -5.0]) == -1.0
    assert signs.position.max() <= 10.0  # mm
    # every sample of a fast press is in a shown cell, where it is alone
    x = np.append(np.repeat(np.linspace(0.0, 10.0, 36), 9), np.linspace(0.0, 10.0, 20))
    speed, used = np.where(np.arange(len(x)) < 324, 0.0, 150.0), np.ones(len(x), dtype=np.bool_)
    fast = residual_map(x, speed, np.ones(len(x)), used)
    assert np.isfinite(fast.mean).sum() == 36 + 20
    np.testing.assert_allclose(fast.mean[np.isfinite(fast.mean)], 1.0)
    # one wrong reading of the speed does not hide the others
    speed = np.append(np.tile(np.linspace(-50.0, 50.0, 100), 10), 5000.0)
    spiked = residual_map(speed, speed, np.ones(len(speed)), np.ones(len(speed), dtype=np.bool_))
    assert np.isfinite(spiked.mean).any(axis=1).sum() >= 30


def test_excluded_samples_are_reported(contact):
    view = channel_view(contact, (), None, scored=np.arange(len(contact)) % 4 > 0)
    assert view.verdict.remarks == ("25 % of the samples are excluded from scoring; the report shades them.",)
    compared = SimpleNamespace(parts={}, exclusion_note="1 in 4 is not judged.")
    told = channel_view(contact, (), None, scored=view.scored, compared=compared)
    assert told.verdict.remarks == ("1 in 4 is not judged.",)


@pytest.mark.parametrize(
    ("std_err", "interval", "shown"),
    [
        (0.5, None, ("12.35", "± 0.98")),
        (0.5, (11.37, 13.33), ("12.35", "± 0.98")),
        (0.5, (12.0, 14.0), ("12.3", "12.0 … 14.0")),
        (None, None, ("12", "not determined")),
        (float("nan"), None, ("12", "not determined")),
    ],
)
def test_parameter_is_shown_with_its_interval(std_err, interval, shown):
    found = _as_estimate("stiffness.k", ParameterValue(value=12.346, std_err=std_err, unit="N/m"))
    if interval is not None:  # an estimate has an interval of its own
        found = replace(found, interval=interval)
    assert terminal.with_interval(found) == shown


@pytest.mark.parametrize("width", [60, 80, 120])
def test_diagnosis_fits_the_terminal_and_breaks_no_name(contact, width):
    long = accepted("load_dependent_friction", 0.5, 0.2, "asymmetric_friction")
    ranking = [{"effect": "load_dependent_friction", "rmse_held_out": 0.2, "score": 0.6}]
    found = diagnosis("missing", long, after=0.2, ranking=ranking)
    view = channel_view(contact, (), None, diagnosis=found)
    out = io.StringIO()
    terminal.print_diagnosis(Console(file=out, width=width), StudyView("f", (view,)))
    lines = out.getvalue().splitlines()
    assert all(len(line) <= width for line in lines)
    assert sum("load_dependent_friction" in line for line in lines) >= 3
    assert any("these data cannot tell it from asymmetric_friction" in line for line in lines) or width == 60


def test_colors_of_speeds_differ_and_run_from_slow_to_fast():
    for count in range(2, len(palette.SPEEDS) + 1):
        colors = list(palette.speed_colors([str(i) for i in range(count)]).values())
        assert len(set(colors)) == count
        assert (colors[0], colors[-1]) == (palette.SPEEDS[0], palette.SPEEDS[-1])
