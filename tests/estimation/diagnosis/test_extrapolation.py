"""Error beyond the motion of the other runs."""

import numpy as np
import pytest

from palpate.estimation.diagnosis.diagnose import diagnose_channel
from palpate.estimation.diagnosis.extrapolation import extrapolation
from palpate.estimation.diagnosis.result import Verdict
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from tests.estimation.contact_data import channel, swing
from tests.estimation.searches import PRESS


def presses(deepest_m, layer_m=0.008, added=4500.0):
    """Presses of an object whose stiffness of 500 N/m grows below a layer, one for each depth."""
    parts = [swing(800, deepest_m=deepest) for deepest in deepest_m]
    time_s, depth, velocity = (np.concatenate(part) for part in zip(*parts, strict=True))
    force = 500.0 * depth + added * np.maximum(depth - layer_m, 0.0) + 0.2 * velocity
    force += 0.01 * np.random.default_rng(3).standard_normal(len(force))
    return channel(force, depth, velocity, time_s, run=np.repeat(np.arange(len(deepest_m)), 800))


@pytest.mark.parametrize(("deepest_m", "deep"), [((0.007, 0.0075, 0.012), 2), ((0.012, 0.007, 0.007), 0)])
def test_error_at_depths_of_a_single_run_is_reported(deepest_m, deep):
    found = extrapolation(fit_model(presses(deepest_m), PRESS, {}))
    assert found.run == deep
    assert found.share > 0.7
    limit_mm = 1e3 * sorted(deepest_m)[1] + 0.1  # where `swing` begins
    assert f"run {deep}, at depths of more than {limit_mm:.2f} mm" in found.describe("squared error")


@pytest.mark.parametrize("deepest_m", [(0.012, 0.012, 0.007), (0.012, 0.0119, 0.0121), (0.012,)])
def test_error_at_depths_of_two_runs_or_of_the_only_run_is_not_reported(deepest_m):
    assert extrapolation(fit_model(presses(deepest_m), PRESS, {})) is None


def test_difference_of_the_only_deep_run_may_be_a_law_of_the_motion():
    """A gain of each run explains the run that reaches the stiff layer, but so would the layer."""
    effects = (EFFECTS["run_gain"](),)
    data = presses((0.002, 0.0022, 0.006), layer_m=0.003, added=1500.0)
    found = diagnose_channel(data, PRESS, effects, np.random.default_rng(0))
    assert [entry.effect for entry in found.accepted] == ["run_gain"]
    assert "a law of the motion may look like this difference between runs" in found.reason
    assert found.next_experiment.instruction.startswith("repeat the motion of run 2")
    assert found.next_experiment.purpose.startswith("tell differences between runs from a law of the motion")


def test_verdict_states_the_extrapolation_and_asks_for_another_such_run():
    verdict = diagnose_channel(presses((0.007, 0.0075, 0.012)), PRESS, (), np.random.default_rng(0))
    assert verdict.verdict is Verdict.UNEXPLAINED
    assert (
        "of the squared error lies at positions or velocities that only one run contains (the largest "
        "part in run 2" in verdict.reason
    )
    assert verdict.next_experiment.instruction.startswith("repeat the motion of run 2")
