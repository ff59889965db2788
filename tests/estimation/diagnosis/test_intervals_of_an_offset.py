"""How sure a surface is must not depend on whether a sample happens to lie just on it."""

import numpy as np

from estimation.effects import EFFECTS
from estimation.fit.intervals import final, inner_slopes, values
from estimation.fit.standing import stand
from estimation.fit.trial import attempt
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.presses import session

OFFSET = "contact_offset.offset"
MODEL_WITH_OFFSET = MODEL.with_effect(EFFECTS["contact_offset"]())


def test_the_surface_is_as_uncertain_as_it_scatters():
    found = [values(*final(stand(session(seed), MODEL_WITH_OFFSET, {})))[OFFSET] for seed in range(6)]
    scatter = np.std([value.value for value in found])
    said = np.array([value.std_err for value in found])
    assert np.all((0.3 * scatter < said) & (said < 3.0 * scatter))


def test_a_sample_that_a_small_step_carries_over_the_surface_has_no_slope():
    bench, trial = final(stand(session(4), MODEL_WITH_OFFSET, {}))
    rows = bench.frame.rows[bench.kept].ravel()
    position_m, speed_m_s = bench.frame.data.position[rows], bench.frame.data.velocity[rows]
    inwards = np.flatnonzero((position_m > 1e-4) & (speed_m_s > 0.02))
    touching_m = float(position_m[inwards].min()) + 1e-9
    there = attempt(bench, MODEL_WITH_OFFSET, {**trial.parameters, OFFSET: touching_m})
    (slope,) = inner_slopes(bench, there)
    stiffness = there.parameters["stiffness.k"]  # by which the force falls with the offset, and hardly more
    assert 0.9 * stiffness < np.abs(slope).max() < 3.0 * stiffness
