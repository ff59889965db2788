"""What the online estimators promise: calm at rest, quick after a change, indifferent to outliers."""

import numpy as np
import pytest

from estimation.estimators import ESTIMATORS
from estimation.estimators.cusum_rls import CusumRls
from estimation.estimators.preemptive_ransac import PreemptiveRansac
from estimation.estimators.sprls import Sprls

DAMPING = 20.0
CHANGE = 3000


def excited(stiffness, *, share=0.0, noise_n=0.005, outliers=0.0, seed=0):
    """Rows and forces of a motion of 5 and 8 Hz; `stiffness` (n,) of each sample."""
    rng = np.random.default_rng(seed)
    t = np.arange(len(stiffness)) * 1e-3
    depth = 0.008 + 0.004 * np.sin(10 * np.pi * t) + 0.0025 * np.sin(16 * np.pi * t + 1)
    rows = np.column_stack([depth, np.gradient(depth, 1e-3)])
    force = stiffness * depth + DAMPING * rows[:, 1]
    measured = force + np.hypot(noise_n, share * force) * rng.standard_normal(len(t))
    wrong = rng.random(len(t)) < outliers
    return rows, np.where(wrong, measured + rng.uniform(-1.0, 4.0, len(t)), measured)


def follow(estimator, rows, forces):
    estimator.start(rows.shape[1])
    return np.array(
        [estimator.update(row, force)[0] for row, force in zip(rows, forces.tolist(), strict=True)]
    )


def stepped(count=4000):
    return np.where(np.arange(count) < CHANGE, 500.0, 1000.0)


@pytest.mark.parametrize("noise", [{"noise_n": 0.02}, {"share": 0.02}, {"share": 0.1}])
def test_a_step_is_tracked_within_100_ms(noise):
    late = [follow(CusumRls(), *excited(stepped(), seed=seed, **noise))[CHANGE + 100] for seed in range(5)]
    np.testing.assert_allclose(late, 1000.0, rtol=0.05)


def test_at_rest_it_scatters_far_less_than_the_self_perturbing_one():
    data = excited(np.full(CHANGE, 500.0), share=0.1)
    calm, perturbed = (np.var(follow(each, *data)[1500:]) for each in (CusumRls(), Sprls()))
    assert calm < 0.25 * perturbed


def test_without_a_change_it_is_recursive_least_squares():
    data = excited(np.full(2000, 500.0), noise_n=0.02)
    np.testing.assert_allclose(follow(CusumRls(), *data), follow(ESTIMATORS["rls"](), *data))


def test_outliers_do_not_move_the_consensus():
    data = excited(np.full(2000, 500.0), noise_n=0.02, outliers=0.3)
    assert follow(PreemptiveRansac(), *data)[-1] == pytest.approx(500.0, rel=0.005)
    assert abs(follow(ESTIMATORS["rls"](), *data)[-1] - 500.0) > 10.0


def test_a_new_consensus_takes_over():
    data = excited(stepped(), noise_n=0.02, outliers=0.2)
    found = follow(PreemptiveRansac(), *data)
    assert found[CHANGE - 1] == pytest.approx(500.0, rel=0.01)
    assert found[CHANGE + 400] == pytest.approx(1000.0, rel=0.01)
