"""The frequency at which a signal swings, whose samples come in pieces."""

import tracemalloc

import numpy as np
import pytest
from scipy.signal import lombscargle

from estimation.signals.periodicity import strongest_frequency


def recorded(begins_s, length, step_s=0.005):
    time_s = np.concatenate([begun + step_s * np.arange(length) for begun in begins_s])
    return time_s, np.repeat(np.arange(len(begins_s)), length)


def test_a_peak_is_that_of_a_periodogram_on_the_samples():
    time_s, run = recorded([12.3], 1500)
    signal = np.sin(2 * np.pi * 3.3 * time_s) + np.random.default_rng(0).normal(0.0, 0.5, len(time_s))
    known = np.random.default_rng(1).random(len(time_s)) < 0.7
    found_hz, share, _ = strongest_frequency(time_s, run, np.where(known, signal, np.nan), 0.005)
    values = signal[known] - signal[known].mean()
    every_hz = np.arange(1.0, 70.0, 0.01)
    expected = lombscargle(time_s[known], values, 2 * np.pi * every_hz, normalize=True)
    assert found_hz == pytest.approx(every_hz[np.argmax(expected)], abs=0.02)
    assert share == pytest.approx(expected.max(), rel=0.01)


def test_pieces_of_any_clock_swing_together():
    time_s, run = recorded([0.0, 3.1234, 1e4], 600)
    signal = np.sin(2 * np.pi * 7.3 * time_s + run) + np.random.default_rng(0).normal(0.0, 0.5, len(time_s))
    found_hz, share, _ = strongest_frequency(time_s, run, signal, 0.005)
    assert found_hz == pytest.approx(7.3, rel=0.01)
    assert share == pytest.approx(0.5 / (0.5 + 0.25), abs=0.05)


def test_a_long_recording_takes_little_memory_and_its_frequency_is_right():
    time_s, run = recorded([0.0, 61.0, 122.0], 12_000)
    tracemalloc.start()
    found_hz, share, _ = strongest_frequency(time_s, run, np.sin(2 * np.pi * 0.83 * time_s), 0.005)
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()
    assert found_hz == pytest.approx(0.83, rel=0.003)
    assert share > 0.9


def test_a_gap_within_a_run_makes_it_no_longer():
    time_s, run = recorded([0.0, 1e6], 500)
    tracemalloc.start()
    found_hz, _, _ = strongest_frequency(time_s, 0 * run, np.sin(2 * np.pi * 4.0 * time_s), 0.005)
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()
    assert found_hz == pytest.approx(4.0, rel=0.03)


def test_too_short_pieces_have_no_frequency():
    time_s, run = recorded([0.0, 1.0, 2.0], 8)
    assert strongest_frequency(time_s, run, np.sin(time_s), 0.005) is None
