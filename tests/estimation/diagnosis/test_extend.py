"""An effect is added because somebody asked for it."""

import numpy as np
from estimation.diagnosis.search.extend import extend
from estimation.diagnosis.search.screening import screen

from estimation.effects import EFFECTS
from estimation.fit.standing import stand
from tests.estimation.diagnosis.test_common_cause import ARM, joints


def test_what_makes_no_sense_starts_where_it_did_best_and_not_at_nothing():
    data, friction = joints(lambda joint, data: 0.0)[0], EFFECTS["stribeck_friction"]()
    start = stand(data, ARM, {})
    assert not screen(start, [friction])  # there is no friction
    with np.errstate(divide="raise", invalid="raise"):
        after = extend(data, start, friction)
    assert min(after.trial.parameters[f"stribeck_friction.{p.name}"] for p in friction.inner) > 0.0
