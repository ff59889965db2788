"""Which effects the search tries in earnest."""

import numpy as np
import pytest

from estimation.diagnosis.candidates import Candidate
from estimation.effects import EFFECTS
from estimation.fit.inner_search import Attempts
from estimation.fit.standing import fit
from estimation.fit.trial import attempt
from estimation.model import Model
from tests.estimation.swings import swings

BASE = tuple(EFFECTS[name]() for name in ("pendulum", "viscous_friction"))


def rippling(q, v, a):
    return 0.3 * np.sin(15.0 * q) + 0.3 * np.tanh(v / 0.01)


@pytest.mark.parametrize("cycles", [14.9, 15.1])
def test_a_candidate_is_judged_as_if_the_parameters_of_the_others_followed(cycles):
    """A ripple whose period is off hides what friction explains; its slope by the period shows that."""
    ripple, friction = EFFECTS["torque_ripple"](), EFFECTS["coulomb_friction"]()
    model = Model("pendulum", (*BASE, ripple, friction))
    inner = {"torque_ripple.cycles": cycles, "coulomb_friction.transition": 0.01}
    whole = fit(swings(1, rippling), model, {**inner, "torque_ripple.cycles": 15.0})
    off = attempt(whole.plain, model, inner)
    followed = Candidate(friction, Attempts((off,), 1)).followed(whole.plain)
    assert off.held_out > 1.5 * whole.trial.held_out
    assert followed == pytest.approx(whole.trial.held_out, rel=0.1)
