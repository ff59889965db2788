from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.signal import savgol_filter

from palpate.estimation.signals import exponential_memory
from palpate.estimation.signals.blocks import blocks, runs_by_time
from palpate.estimation.signals.exponential_memory import low_pass, relax, springpot
from palpate.estimation.signals.runwise import (
    bouc_wen,
    derivative,
    direction,
    play,
    running_max,
    shift,
    smooth_jitter,
)

TIME = np.arange(1000) * 0.01
ONE_RUN = np.zeros(1000, dtype=np.int64)


def stepped_play(values, half_width):
    state, out = values[0], []
    for value in values:
        state = min(max(state, value - half_width), value + half_width)
        out.append(state)
    return np.array(out)


@given(arrays.arrays(np.float64, st.integers(1, 60), elements=st.floats(-5, 5)), st.floats(0.01, 3.0))
def test_play_matches_the_sample_by_sample_definition(values, half_width):
    played = play(values, np.zeros(len(values), dtype=np.int64), half_width)
    assert played == pytest.approx(stepped_play(values, half_width))


def test_play_forgets_between_runs():
    two = np.column_stack([np.sin(TIME), np.cos(3 * TIME)])
    played = play(two, np.repeat([0, 1], 500), 0.2)
    for column in range(2):
        assert played[500:, column] == pytest.approx(stepped_play(two[500:, column], 0.2))
    values = np.cumsum(np.random.default_rng(6).standard_normal(5000))
    played = play(values, np.zeros(5000, dtype=np.int64), 3.0)
    np.testing.assert_array_equal(played, stepped_play(values, 3.0))
    for shape in [(0,), (0, 2), (7, 0)]:
        assert play(np.empty(shape), np.zeros(shape[0], dtype=np.int64), 0.2).shape == shape


def test_rates_match_savitzky_golay_run_by_run():
    signal = np.random.default_rng(0).standard_normal(62)
    run = np.repeat([0, 1, 2, 3], [30, 4, 5, 23])
    slope = derivative(signal, np.arange(62) * 0.01, run)
    for number, rows in ((0, slice(0, 30)), (2, slice(34, 39)), (3, slice(39, 62))):
        wanted = savgol_filter(signal[rows], 5, 3, deriv=1, delta=0.01)
        np.testing.assert_allclose(slope[rows], wanted, atol=1e-9 * np.abs(wanted).max(), err_msg=str(number))
    np.testing.assert_array_equal(slope[30:34], 0.0)
    assert len(derivative(signal[:3], np.arange(3) * 0.01, run[:3])) == 3


def test_lag_follows_a_step_and_a_held_strain_relaxes():
    lagged = low_pass((TIME > 2.0).astype(float), TIME, ONE_RUN, 0.5)
    assert lagged[700] == pytest.approx(1 - np.exp(-(7.0 - 2.005) / 0.5), abs=2e-3)
    left = relax(np.where(TIME >= 1.0, 1.0, 0.0), TIME, ONE_RUN, 2.0)
    assert left[500] / left[300] == pytest.approx(np.exp(-2.0 / 2.0), rel=1e-6)


@pytest.mark.parametrize("uneven_s", [0.0, 0.004])
def test_strain_memory_persists_between_presses(uneven_s):
    time_s = TIME + uneven_s * (np.arange(1000) % 2)
    strain = np.maximum(np.sin(2.0 * time_s), 0.0)
    seen = (time_s < 1.8) | (time_s > 2.9)  # nothing was recorded in between
    run = np.where(time_s < 2.5, 3, 7)
    whole = relax(strain, time_s, ONE_RUN, 0.8)
    assert relax(strain[seen], time_s[seen], run[seen], 0.8) == pytest.approx(whole[seen], abs=1e-9)
    order = np.argsort(-run, kind="stable")  # the numbers of the runs say nothing
    assert relax(strain[order], time_s[order], -run[order], 0.8) == pytest.approx(whole[order], abs=1e-9)
    first, second = run[seen] == 3, run[seen] == 7
    later = np.concatenate([strain[seen][second], strain[seen][first]])
    times = np.concatenate([time_s[seen][second], time_s[seen][first]])
    alone = relax(later, times, np.repeat([0, 1], [second.sum(), first.sum()]), 0.8)
    assert alone[second.sum() :] == pytest.approx(whole[seen][first], abs=1e-9)  # time went back: by itself


def test_direction_reverses_over_its_path_and_a_signal_has_its_maximum():
    s = direction(np.where(TIME < 3, TIME, np.where(TIME < 6, 3.0, 9.0 - TIME)), ONE_RUN, 0.1)
    assert s[[250, 550, 990]] == pytest.approx([1.0, 1.0, -1.0], abs=1e-6)
    assert s[610] == pytest.approx(2 * np.exp(-1.0) - 1, abs=1e-3)

    assert running_max(np.sin(TIME), ONE_RUN)[-1] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("delay_s", [0.0, 0.0004, 0.003, 0.0127, 2.0, -0.0004, -0.003, -0.0127, -2.0])
@pytest.mark.parametrize("uneven", [0.0, 0.4])
def test_shift_is_exact_for_cubics_and_stays_within_each_run(delay_s, uneven):
    rng = np.random.default_rng(0)
    run = np.repeat([0, 1, 2], [1, 7, 300])
    time_s = (np.arange(len(run)) + uneven * rng.uniform(-1, 1, len(run))) * 1e-3
    for number in range(3):
        rows = run == number
        t = time_s[rows]
        law = np.polynomial.Polynomial(rng.normal(size=4), domain=[0.0, 0.3])
        signal = rng.normal(size=(len(run), 2))
        signal[rows] = np.column_stack([law(t), law(t) ** 0])
        shifted = shift(signal, time_s, run, delay_s)[rows]
        wanted = law(np.clip(t - delay_s, t[0], t[-1]))
        straight = np.interp(t - delay_s, t, law(t))  # next to the ends there are no four samples
        assert ((np.abs(shifted[:, 0] - wanted) < 1e-9) | (np.abs(shifted[:, 0] - straight) < 1e-9)).all()
        inner = (t - delay_s > t[min(1, len(t) - 1)]) & (t - delay_s < t[-2:][0])
        np.testing.assert_allclose(shifted[inner, 0], wanted[inner], atol=1e-9)
        np.testing.assert_allclose(shifted[:, 1], 1.0)


def test_lag_of_uneven_samples_equals_that_of_even_ones_between():
    fine = np.linspace(0.0, 4.0, 4001)
    kept = np.unique(np.concatenate([[0], np.geomspace(1, 4000, 60).astype(int)]))
    corners = np.cumsum(np.random.default_rng(1).normal(size=len(kept)))
    signal = np.interp(fine, fine[kept], corners)
    for tau_s in (1e-4, 0.03, 2.0):
        whole = low_pass(signal, fine, np.zeros(len(fine), dtype=np.int64), tau_s)
        few = low_pass(corners, fine[kept], np.zeros(len(kept), dtype=np.int64), tau_s)
        np.testing.assert_allclose(few, whole[kept], atol=1e-9)


@pytest.mark.parametrize("step_s", [0.001, 0.005, 0.02])
def test_smoothed_position_is_a_local_cubic_within_each_run(step_s):
    run = np.repeat([0, 1, 2], [4, 200, 3000])
    position = np.cumsum(np.random.default_rng(0).normal(size=len(run)))
    found = smooth_jitter(position, np.arange(len(run)) * step_s, run)
    window = 2 * int(0.0125 / step_s) + 1
    np.testing.assert_array_equal(found[run == 0], position[run == 0])  # shorter than any window
    for number in (1, 2):
        values = position[run == number]
        wanted = savgol_filter(values, window, 3) if window > 3 else values
        np.testing.assert_allclose(found[run == number], wanted, atol=1e-10)


def some_runs(rng):
    """A wavy signal, its times and runs of very different lengths, one of a single sample."""
    run = np.repeat([4, 2, 9, 1, 7], [400, 1, 30, 2, 567])
    return np.cumsum(rng.standard_normal(1000)), TIME, run


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("tau_s", [1e-6, 0.02, 0.3, 3.0, 500.0])
def test_lag_of_all_runs_at_once_equals_each_run_alone(tau_s, uneven):
    signal, time_s, run = some_runs(np.random.default_rng(3))
    if uneven:
        time_s = np.cumsum(np.random.default_rng(2).uniform(0.005, 0.015, len(run)))
    both = np.column_stack([signal, np.sin(signal)])
    lagged = low_pass(both, time_s, run, tau_s)
    for number in (4, 9, 7):
        rows = run == number
        for column in range(2):
            alone = low_pass(both[rows, column], time_s[rows], run[rows], tau_s)
            np.testing.assert_allclose(lagged[rows, column], alone, atol=1e-10)
    assert lagged[run == 2] == pytest.approx(both[run == 2])


def test_direction_of_all_runs_at_once_equals_each_run_alone():
    signal, _, run = some_runs(np.random.default_rng(4))
    turned = direction(signal, run, 2.0)
    for number in np.unique(run):
        rows = run == number
        np.testing.assert_allclose(turned[rows], direction(signal[rows], run[rows], 2.0), atol=1e-9)
    assert direction(np.zeros(0), np.zeros(0, dtype=np.int64), 1.0).shape == (0,)


def test_overlapping_runs_have_their_own_clocks_and_keep_their_order():
    run = np.repeat([0, 1, 2], [3, 3, 3])
    later = np.array([10.0, 11, 12, 0, 1, 2, 5, 6, 7])
    assert [rows.start for rows in runs_by_time(later, run)] == [3, 6, 0]
    own = np.array([0.2, 1, 2, 0.1, 1, 2, 0, 1, 2])
    assert [rows.start for rows in runs_by_time(own, run)] == [0, 3, 6]


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.5, 0.9])
@pytest.mark.parametrize("scale_s", [1e-4, 1.0, 1e4])
def test_springpot_answers_a_ramp_in_closed_form_at_uneven_times(alpha, scale_s):
    t = np.concatenate([np.linspace(0, 1, 20), 1 + np.geomspace(1e-3, 100, 80)]) * scale_s
    ramp = np.minimum(t / scale_s, 1.0)
    since = np.maximum(t - scale_s, 0.0)
    wanted = (t ** (1 - alpha) - since ** (1 - alpha)) / (1 - alpha) / scale_s
    both = springpot(np.column_stack([ramp, -3.0 * ramp]), t, np.zeros(100, dtype=np.int64), alpha)
    np.testing.assert_allclose(both[:, 0], wanted, atol=1.2e-3 * wanted.max())
    np.testing.assert_allclose(both[:, 1], -3.0 * both[:, 0])


def test_uneven_strain_is_relaxed_once_for_all_exponents(monkeypatch):
    t, run, recursion = np.cumsum(np.geomspace(0.1, 1.0, 50)), np.zeros(50, dtype=np.int64), Mock()
    strain = t**2
    for array in (t, run, strain):
        array.setflags(write=False)
    first, again = springpot(strain, t, run, 0.3), springpot(strain.copy(), t, run, 0.4)
    monkeypatch.setattr(exponential_memory, "_linear_recursion", recursion)
    np.testing.assert_array_equal(springpot(strain, t, run, 0.3), first)
    np.testing.assert_allclose(springpot(strain, t, run, 0.4), again, rtol=1e-12)
    assert not recursion.called


def test_bouc_wen_is_a_dahl_direction_or_a_slipping_spring():
    signal, _, run = some_runs(np.random.default_rng(5))
    np.testing.assert_allclose(bouc_wen(signal, run, 2.0, 1.0, 1.0), direction(signal, run, 2.0), atol=1e-4)
    signal, _, run = some_runs(np.random.default_rng(6))
    w = bouc_wen(signal, run, 1.5, 400.0, 0.0)
    stop = np.concatenate(
        [signal[run == number] - stepped_play(signal[run == number], 1.5) for number in (4, 2, 9, 1, 7)]
    )
    np.testing.assert_allclose(w, stop / 1.5, atol=0.02)


@pytest.mark.parametrize(
    ("values", "expected"), [([], []), ([3], [(0, 1)]), ([1, 1, 2, 2, 2, 1], [(0, 2), (2, 5), (5, 6)])]
)
def test_blocks_are_stretches_of_equal_values(values, expected):
    assert [(rows.start, rows.stop) for rows in blocks(np.array(values, int))] == expected


@pytest.mark.parametrize("uneven", [False, True])
def test_shift_keeps_the_shape_of_a_signal_without_columns(uneven):
    time_s = TIME + (0.3 * (TIME[1] - TIME[0]) * (np.arange(len(TIME)) % 2) if uneven else 0.0)
    assert shift(np.empty((len(TIME), 0)), time_s, ONE_RUN, 0.105).shape == (len(TIME), 0)


@pytest.mark.parametrize(("delay_s", "held"), [(1e3, 0), (-1e3, -1)])
def test_shift_by_more_than_the_run_holds_its_end(delay_s, held):
    signal = np.sin(TIME)
    np.testing.assert_array_equal(shift(signal, TIME, ONE_RUN, delay_s), signal[held])


def test_shift_follows_times_changed_in_place():
    time_s = np.cumsum(0.01 + 0.003 * (np.arange(1000) % 2))
    signal = np.sin(time_s)
    shift(signal, time_s, ONE_RUN, 0.105)
    time_s[500:] += 2.0
    np.testing.assert_array_equal(
        shift(signal, time_s, ONE_RUN, 0.105), shift(signal, time_s.copy(), ONE_RUN, 0.105)
    )
