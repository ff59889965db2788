"""What a search keeps of long data: the blocks of a few trials, not of all."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.diagnosis.judgement.noise_floor import repeats

from estimation.effects import EFFECTS
from estimation.fit.frame import frame_of
from estimation.fit.inner_search import look, refine
from estimation.fit.standing import stand
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.presses import session

DATA = session(3)


def test_trials_between_the_starts_keep_no_blocks_unless_they_are_best():
    standing, effect = stand(DATA, MODEL, {}), EFFECTS["saturation"]()
    model = MODEL.with_effect(effect)
    looked = look(standing.plain, model, effect, standing.trial.parameters, effect.starts(DATA))
    refined = refine(standing.plain, model, effect, looked)
    assert len(refined.trials) > refined.start_count
    assert all(len(trial.columns) for trial in (*refined.starts, refined.best))
    others = [trial for trial in refined.trials[refined.start_count :] if trial is not refined.best]
    assert others
    assert not any(trial.columns.size + trial.target.size for trial in others)
    bare = refined.without_blocks()
    assert not any(trial.columns.size for trial in bare.trials)
    np.testing.assert_array_equal(bare.held_out, refined.held_out)
    assert bare.best.parameters == refined.best.parameters


def test_blocks_are_those_of_each_run_also_where_runs_take_turns():
    turns = replace(DATA, run=np.arange(len(DATA)) % 3)
    frame = frame_of(turns)
    assert (turns.run[frame.rows] == frame.run[:, None]).all()
    assert (np.diff(frame.rows, axis=1) == 3).all()
    assert np.unique(frame.fold[frame.run == 1]).size == 1


def test_of_very_many_runs_only_neighbours_are_compared():
    runs, count = 3000, 60
    rng = np.random.default_rng(2)
    few = DATA.select(np.arange(runs * count) % count)
    run = np.repeat(np.arange(runs), count)
    many = replace(few, run=run, time_s=few.time_s + 10.0 * run)
    drift = 0.01 * (run // 2)  # all but neighbours differ by more than the noise
    assert repeats(many, drift + rng.normal(0.0, 0.05, runs * count)) == pytest.approx(0.05, rel=0.02)
