import numpy as np
import pytest
from estimation.diagnosis.search.surrogates import best_gains, p_value, surrogates
from scipy.signal import lfilter

from estimation.fit.colour import colour_of
from estimation.fit.frame import frame_of
from estimation.fit.moments import moments_of, score
from tests.estimation.presses import session


def test_scores_are_those_of_fits_without_the_fold():
    rng = np.random.default_rng(0)
    columns, fold = rng.normal(size=(300, 3)) * [1.0, 50.0, 1e-3], rng.integers(0, 4, 300)
    target = columns @ [2.0, -0.1, 500.0] + rng.normal(size=300)
    found = score(moments_of(columns, target, fold, 4), dof=300)
    gains = np.linalg.lstsq(columns, target, rcond=None)[0]
    assert found.gains == pytest.approx(gains, rel=1e-6)
    for number in range(4):
        train = fold != number
        own = np.linalg.lstsq(columns[train], target[train], rcond=None)[0]
        assert found.fold_gains[number] == pytest.approx(own, rel=1e-6)
        left = target[~train] - columns[~train] @ own
        assert found.held_out[number] == pytest.approx(left @ left, rel=1e-6)
    variance = np.linalg.inv(columns.T @ columns) * found.sse.sum() / 297
    assert found.spread == pytest.approx(np.sqrt(np.diag(variance)), rel=1e-6)


def test_collinear_columns_do_not_break_the_fit():
    column = np.random.default_rng(1).normal(size=(200, 1))
    found = score(moments_of(np.hstack([column, column]), 3 * column[:, 0], np.arange(200) % 3, 3))
    assert found.gains.sum() == pytest.approx(3.0, rel=1e-6)
    assert found.held_out.sum() < 1e-6


def test_colour_is_recovered_and_taken_out():
    rng = np.random.default_rng(2)
    run = np.repeat(np.arange(10), 1000)
    noise = np.concatenate([lfilter([1.0], [1.0, -0.9], rng.normal(size=1200))[200:] for _ in range(10)])
    colour = colour_of(noise, run, np.ones(10000, dtype=bool))
    assert colour.memory == pytest.approx([0.9, 0.0, 0.0, 0.0], abs=0.05)
    kept = colour.kept(run, np.ones(10000, dtype=bool))
    assert not kept[[0, 1, 2, 3, 1000, 5003]].any()
    white = colour.whiten(noise)[kept]
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03


def test_surrogates_keep_the_noise_and_lose_its_tie():
    rng = np.random.default_rng(3)
    run = np.repeat([0, 1], 500)
    noise = np.convolve(rng.normal(size=1004), np.ones(5), "valid")
    made = surrogates(noise, run, rng, 50)
    assert np.sort(np.abs(made[:500]), axis=0) == pytest.approx(
        np.sort(np.abs(noise[:500]))[:, None] + np.zeros(50)
    )
    assert np.mean([abs(np.corrcoef(noise, column)[0, 1]) for column in made.T]) < 0.15


def test_p_values_are_small_only_for_real_gains():
    rng = np.random.default_rng(4)
    base, candidate = rng.normal(size=(400, 2)), rng.normal(size=(400, 3))
    both = np.hstack([base, candidate])
    chance = best_gains(rng.normal(size=(400, 199)), base, [both])
    assert p_value(0.5, chance) == pytest.approx(1 / 200)
    # chance gains of three extra columns follow their degrees of freedom: 3 of 398
    assert np.mean(chance) == pytest.approx(3 / 398, rel=0.25)
    assert p_value(float(np.median(chance)), chance) == pytest.approx(0.5, abs=0.02)


def test_blocks_hold_whole_runs_out_and_leave_the_edge_of_contact():
    data = session(1)
    frame = frame_of(data)
    for fold in range(frame.folds):
        inside = set(frame.run[frame.fold == fold])
        assert inside.isdisjoint(frame.run[frame.fold != fold])
    engaged = data.engaged[frame.rows]
    assert (engaged.all(axis=1) | ~engaged.any(axis=1))[frame.trusted].all()
    assert frame.trusted.mean() > 0.97
    assert frame.reduce(data.position)[7] == pytest.approx(data.position[frame.rows[7]].mean())
