"""Residual analysis: correlation beside definitions and statsmodels, periodic components, and noise."""

import tracemalloc

import numpy as np
import pytest
from scipy.signal import lfilter, lombscargle

from palpate.estimation.signals.periodicity import strongest_frequency
from palpate.estimation.statistics.correlation import (
    SIGMAS_99,
    autocorrelation,
    cross_correlation,
    fit_percent,
    noise_between_samples,
    residual_scale,
)

N, LAGS = 4000, 30
ONE_RUN = np.zeros(N, dtype=int)


def noise(seed, n=N):
    return np.random.default_rng(seed).normal(size=n)


@pytest.mark.parametrize(
    ("modeled", "percent"),
    [(lambda y: y, 100.0), (lambda y: 0 * y + y.mean(), 0.0), (lambda y: 2 * y.mean() - y, -100.0)],
)
def test_fit_percent_is_100_for_the_truth_and_0_for_the_mean(modeled, percent):
    y = 3.0 + noise(0)
    assert fit_percent(y, modeled(y)) == pytest.approx(percent)
    assert fit_percent(np.append(y, np.nan), np.append(modeled(y), 1.0)) == pytest.approx(percent)


def test_fit_of_a_constant_or_empty_signal_is_nan():
    assert np.isnan(fit_percent(np.ones(9), np.ones(9)))
    assert np.isnan(fit_percent(np.full(9, np.nan), np.ones(9)))


@pytest.mark.parametrize("coefficient", [0.0, 0.5, -0.7])
def test_autocorrelation_matches_statsmodels(coefficient):
    from statsmodels.tsa.stattools import acf  # slow: not in every process that collects tests

    x = lfilter([1.0], [1.0, -coefficient], noise(1))
    ours = autocorrelation(x, ONE_RUN, LAGS)
    np.testing.assert_allclose(ours.value, acf(x, adjusted=True, nlags=LAGS), atol=1e-12)
    np.testing.assert_allclose(ours.value[:4], coefficient ** np.arange(4), atol=0.06)


def test_both_correlations_match_statsmodels():
    from statsmodels.tsa.stattools import acf, ccf

    x = lfilter([1.0], [1.0, -0.5], noise(2))
    x[::7] = np.nan
    theirs = acf(x, adjusted=True, nlags=LAGS, missing="conservative")
    np.testing.assert_allclose(autocorrelation(x, ONE_RUN, LAGS).value, theirs, atol=0.03)
    u, e = noise(3), noise(4)
    e[5:] += 0.5 * u[:-5]  # what is left follows the motion five samples later
    ours = cross_correlation(e, u, ONE_RUN, LAGS)
    assert ours.lag[np.nanargmax(np.abs(ours.value))] == 5
    np.testing.assert_allclose(ours.value[LAGS:], ccf(e, u, adjusted=True)[: LAGS + 1], atol=1e-12)
    back = ccf(u, e, adjusted=True)[: LAGS + 1]
    np.testing.assert_allclose(ours.value[LAGS::-1], back, atol=1e-12)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_99_percent_of_independent_signals_are_within_the_band(colour):
    outside = []
    for seed in range(40):
        u, e = (lfilter([1.0], [1.0, -colour], noise(2 * seed + k)) for k in (100, 101))
        outside.append(cross_correlation(e, u, ONE_RUN, LAGS).outside)
        if not colour:
            outside.append(autocorrelation(e, ONE_RUN, LAGS).outside)
    assert np.mean(outside) == pytest.approx(0.01, abs=0.008)


def test_runs_are_never_joined_and_the_band_is_2_58_over_root_n():
    x, run = np.array([1.0, -1.0, -1.0, 1.0]), np.array([0, 0, 1, 1])
    assert autocorrelation(x, run, 1).value[1] == pytest.approx(-1.0)  # joined, they would give -1/3
    short = autocorrelation(np.arange(5.0), np.arange(5), 3)
    assert np.isnan(short.value[1:]).all()
    assert np.isnan(short.outside)
    band = autocorrelation(noise(6), ONE_RUN, 10).band
    assert band[10] == pytest.approx(2.5758 / np.sqrt(N - 10), rel=1e-4)
    assert pytest.approx(2.5758, rel=1e-4) == SIGMAS_99


def recorded(begins_s, length, step_s=0.005):
    time_s = np.concatenate([begun + step_s * np.arange(length) for begun in begins_s])
    return time_s, np.repeat(np.arange(len(begins_s)), length)


def test_spectral_peak_matches_a_periodogram():
    time_s, run = recorded([12.3], 800)
    signal = np.sin(2 * np.pi * 3.3 * time_s) + np.random.default_rng(0).normal(0.0, 0.5, len(time_s))
    known = np.random.default_rng(1).random(len(time_s)) < 0.7
    found_hz, share, _ = strongest_frequency(time_s, run, np.where(known, signal, np.nan), 0.005)
    values = signal[known] - signal[known].mean()
    every_hz = np.arange(1.0, 70.0, 0.01)
    expected = lombscargle(time_s[known], values, 2 * np.pi * every_hz, normalize=True)
    assert found_hz == pytest.approx(every_hz[np.argmax(expected)], abs=0.02)
    assert share == pytest.approx(expected.max(), rel=0.01)


def test_pieces_of_any_clock_oscillate_together():
    time_s, run = recorded([0.0, 3.1234, 1e4], 600)
    signal = np.sin(2 * np.pi * 7.3 * time_s + run) + np.random.default_rng(0).normal(0.0, 0.5, len(time_s))
    found_hz, share, _ = strongest_frequency(time_s, run, signal, 0.005)
    assert found_hz == pytest.approx(7.3, rel=0.01)
    assert share == pytest.approx(0.5 / (0.5 + 0.25), abs=0.05)


@pytest.mark.parametrize(
    ("starts_s", "count", "runs", "true_hz", "off", "bytes_"),
    [
        ([0.0, 61.0, 122.0], 12_000, 3, 0.83, 0.003, 100e6),
        ([0.0, 1e6], 500, 1, 4.0, 0.03, 10e6),  # a gap within a run makes it no longer
    ],
)
def test_long_recording_needs_little_memory_for_its_frequency(starts_s, count, runs, true_hz, off, bytes_):
    time_s, run = recorded(starts_s, count)
    tracemalloc.start()
    signal = np.sin(2 * np.pi * true_hz * time_s)
    found_hz, share, _ = strongest_frequency(time_s, run * (runs > 1), signal, 0.005)
    assert tracemalloc.get_traced_memory()[1] < bytes_
    tracemalloc.stop()
    assert found_hz == pytest.approx(true_hz, rel=off)
    assert share > 0.9


def test_short_pieces_have_no_frequency():
    time_s, run = recorded([0.0, 1.0, 2.0], 8)
    assert strongest_frequency(time_s, run, np.sin(time_s), 0.005) is None


RUN = np.repeat([0, 1, 2], 1000)
ALL = np.ones(3000, dtype=bool)


def white(sigma=0.02, seed=0):
    return np.random.default_rng(seed).normal(0.0, sigma, 3000)


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_has_the_size_of_its_residual(seed):
    residuals = white(seed=seed)
    assert noise_between_samples(residuals, RUN, ALL) == pytest.approx(0.02, rel=0.1)
    assert residual_scale(residuals) == pytest.approx(0.02, rel=0.1)


def test_noise_excludes_slow_residuals_and_outliers_but_the_scale_includes_them():
    slow = 0.2 * np.sin(np.arange(3000) / 100)
    assert noise_between_samples(white() + slow, RUN, ALL) == pytest.approx(0.02, rel=0.1)
    assert residual_scale(white() + slow) == pytest.approx(0.2 * np.sin(0.45 * np.pi) / 1.645, rel=0.1)
    left = white()
    left[400:1000] += 0.5 + np.linspace(0, 1, 600) ** 2
    assert residual_scale(left) > 10 * noise_between_samples(left, RUN, np.abs(left) < 0.1)


def test_kinks_and_steps_between_runs_do_not_count_as_noise():
    left = white()
    left[::50] += 1.0
    assert noise_between_samples(left, RUN, np.abs(left) < 0.1) == pytest.approx(0.02, rel=0.1)
    assert residual_scale(left) == pytest.approx(0.02, rel=0.1)
    left = white(sigma=1e-3) + RUN
    assert noise_between_samples(left, RUN, ALL) == pytest.approx(1e-3, rel=0.1)
    assert np.isnan(noise_between_samples(white()[:10], np.arange(10), ALL[:10]))
