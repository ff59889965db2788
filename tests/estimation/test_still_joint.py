"""A joint that mostly stands still without a torque: no estimator is sure of what the rest contradicts."""

import numpy as np
import pytest

from estimation.data.import_file import import_table
from estimation.data.table import table_of
from estimation.estimators import ESTIMATORS
from estimation.study.estimates import estimate_with

pa = pytest.importorskip("pyarrow")
N = 5000
MOVES = slice(4000, 4800)


def channel_of(torque_of, tmp_path):
    """A joint at rest at zero, that swings once; `torque_of` gives the torque while it does."""
    position, torque = np.zeros(N), np.zeros(N)
    position[MOVES] = 0.3 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 800)))
    torque[MOVES] = torque_of(position[MOVES])
    columns = {"time_s": np.arange(N) / 1000.0, "position_rad": position, "torque_Nm": torque}
    return import_table(table_of(pa.table(columns), tmp_path)).channels[0]


@pytest.mark.parametrize("model", ["inertia", "pendulum", "spring_mass_damper"])
@pytest.mark.parametrize(
    "torque_of",
    [
        lambda position: 0.5 * np.sign(np.gradient(position)),
        lambda position: np.random.default_rng(0).normal(size=len(position)),
    ],
    ids=["dry friction", "noise"],
)
def test_what_fits_only_the_rest_is_not_determined(torque_of, model, tmp_path):
    channel = channel_of(torque_of, tmp_path)
    found = estimate_with(channel, model, list(ESTIMATORS))
    for one in found.estimates:
        assert not any(p.std_err < 1e-9 for p in one.parameters), (one.estimator, one.parameters)
    assert found.best.estimator != "robust" or found.best.identifiability != "none"


def test_columns_of_very_unlike_sizes_leave_a_recursive_estimate_real(tmp_path):
    rng, time_s = (
        np.random.default_rng(1),
        np.arange(60) * 1e-6,
    )  # accelerations of 1e12 beside positions of 1
    x = rng.normal(size=60)
    columns = {"time_s": time_s, "position_rad": x, "torque_Nm": 300.0 * x + 0.01 * rng.normal(size=60)}
    channel = import_table(table_of(pa.table(columns), tmp_path)).channels[0]
    assert estimate_with(channel, "spring_mass_damper", ["cusum_rls"]).estimates


def test_a_law_that_fits_all_of_it_is_known_to_the_last_digit(tmp_path):
    found = estimate_with(
        channel_of(lambda position: 0.5 * position, tmp_path), "spring_mass_damper", ["lsq"]
    )
    stiffness = found.best.parameters[-1]
    assert (found.best.identifiability, stiffness.value) == ("good", pytest.approx(0.5, abs=1e-9))
    assert stiffness.std_err < 1e-9
