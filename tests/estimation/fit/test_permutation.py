"""How much the best of many candidates takes from noise alone."""

import numpy as np
import pytest
from scipy import stats

from estimation.fit.permutation import COUNT, null_improvements, surrogate_residuals

RUN = np.repeat([0, 1], 500)


def test_surrogates_keep_the_noise_s_values_and_colour_and_lose_its_place():
    rng = np.random.default_rng(3)
    noise = np.convolve(rng.normal(size=1004), np.ones(5), "valid")
    made = surrogate_residuals(noise, RUN, rng)
    assert np.sort(np.abs(made[:500]), axis=0) == pytest.approx(
        np.sort(np.abs(noise[:500]))[:, None] + np.zeros(COUNT)
    )
    neighbours = [np.corrcoef(one[1:500], one[:499])[0, 1] for one in made.T]
    assert np.mean(neighbours) == pytest.approx(0.8, abs=0.05)
    assert np.mean([abs(np.corrcoef(noise, one)[0, 1]) for one in made.T]) < 0.15


def test_gains_of_white_noise_follow_the_beta_distribution_of_its_degrees_of_freedom():
    rng = np.random.default_rng(4)
    base, more = rng.normal(size=(1000, 2)), rng.normal(size=(1000, 3))
    found = null_improvements(rng.normal(size=1000), RUN, base, [np.hstack([base, more])], rng)
    assert len(found) == COUNT
    assert stats.kstest(found, stats.beta(1.5, 497.5).cdf).pvalue > 0.01


def test_the_best_of_many_candidates_gains_more_than_one():
    rng = np.random.default_rng(5)
    base, noise = np.ones((1000, 1)), rng.normal(size=1000)
    tried = [np.hstack([base, rng.normal(size=(1000, 1))]) for _ in range(30)]
    one, best = (np.median(null_improvements(noise, RUN, base, some, rng)) for some in (tried[:1], tried))
    expected = stats.chi2(1).ppf(0.5 ** (1 / 30)) / 999  # median of the largest of thirty
    assert best == pytest.approx(expected, rel=0.15)
    assert one < 0.2 * best


def test_slow_noise_gives_more_to_a_slow_law():
    rng = np.random.default_rng(6)
    base = np.ones((1000, 1))
    slow = np.hstack([base, np.sin(np.arange(1000) / 40.0)[:, None]])

    def gain(width):
        """Of noise averaged over so many samples; ten recordings, since each has little of so slow a wave."""
        made = [np.convolve(rng.normal(size=999 + width), np.ones(width), "valid") for _ in range(10)]
        return np.mean([null_improvements(noise, RUN, base, [slow], rng) for noise in made])

    assert gain(20) > 5.0 * gain(1)


def test_columns_of_nothing_gain_nothing():
    rng = np.random.default_rng(6)
    base, noise = np.ones((1000, 1)), rng.normal(size=1000)
    again = np.hstack([base, 3.0 * base, np.zeros((1000, 1))])
    assert null_improvements(noise, RUN, base, [again], rng) == pytest.approx(0.0, abs=1e-6)
    assert null_improvements(noise, RUN, np.empty((1000, 0)), [], rng) == pytest.approx(0.0)
