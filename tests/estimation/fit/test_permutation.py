"""Null distribution of the best candidate's improvement."""

import numpy as np
import pytest

from palpate.estimation.fit.permutation import COUNT, null_improvements


def surrogates(noise, rng):
    """Shifted and mirrored copies of the noise of one run, drawn as the test draws them."""
    shifts, signs = rng.integers(0, len(noise), COUNT), rng.choice([-1.0, 1.0], COUNT)
    return np.array([sign * np.roll(noise, -shift) for shift, sign in zip(shifts, signs, strict=True)])


def squares_left(columns, efforts):
    return np.array(
        [np.sum((e - columns @ np.linalg.lstsq(columns, e, rcond=1e-9)[0]) ** 2) for e in efforts]
    )


@pytest.mark.parametrize("size", [-3e4, 1e-4, 3e4])
def test_largest_share_equals_that_of_separate_fits(size):
    """A column that the base model spans explains nothing, whatever its sign and size."""
    rng = np.random.default_rng(0)
    noise, base = rng.normal(size=60), np.column_stack([np.ones(60), np.arange(60.0)])
    spanned, new = size * (1.0 + base @ [2.0, 0.1]), rng.normal(size=(60, 3))
    candidates = [np.column_stack([base, spanned, new[:, 0]]), np.column_stack([base, new[:, 1:]])]
    null = null_improvements(noise, np.zeros(60, int), base, candidates, np.random.default_rng(1))
    drawn = surrogates(noise, np.random.default_rng(1))
    before = squares_left(base, drawn)
    shares = [1.0 - squares_left(columns, drawn) / before for columns in candidates]
    assert null == pytest.approx(np.max(shares, axis=0), abs=1e-5)
