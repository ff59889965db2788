"""Whether a run began with a relaxed object."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from palpate.estimation.data.file_columns import FileColumns
from palpate.estimation.data.import_file import import_table
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import table_of
from palpate.estimation.signals.blocks import since_start
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.fitting import recovers_between_runs
from tests.estimation.presses import RATE_HZ, kelvin_voigt, maxwell, session

TAU_S = 1.5


def remembered(time_s, x, tau_s):
    """The same spring and dashpot, never let go: what has not flowed back between two runs is still there."""
    z, before_m = np.zeros_like(x), 0.0
    pressed = np.maximum(x, 0.0)
    left = 0.0
    for i in range(len(x)):
        step_s = time_s[i] - time_s[i - 1] if i else 1.0 / RATE_HZ
        left = (left * np.exp(-(step_s - 1.0 / RATE_HZ) / tau_s) + pressed[i] - before_m) / (
            1.0 + 1.0 / RATE_HZ / tau_s
        )
        z[i], before_m = left, pressed[i]
    return z


@pytest.mark.parametrize("cubic_n_m3", [0.0, 1e7])
@pytest.mark.parametrize("afresh", [True, False])
def test_data_decide_whether_the_object_remembered(afresh, cubic_n_m3):
    def law(t, x, v, run):
        relaxing = 500.0 * (maxwell(t, x, run, TAU_S) if afresh else remembered(t, x, TAU_S))
        return kelvin_voigt(x, v, relaxing + cubic_n_m3 * x**3)

    data = session(61, law)
    assert recovers_between_runs(data) == afresh
    assert not recovers_between_runs(replace(data, time_s=since_start(data.time_s, data.run)))
    study = ModelStudy(data)
    values = study.fit("contact", ["cubic_stiffness", "stress_relaxation"]).values
    assert values["stress_relaxation.tau"] == pytest.approx(TAU_S, rel=0.1)
    assert ("relaxation restarts in each run" in " ".join(study.notes)) == afresh


def test_fresh_runs_keep_spread_times_and_need_relaxation():
    t = np.arange(400) * 0.01
    x, f = 0.004 * (1.0 - np.cos(3.0 * t)), 2.0 * (1.0 - np.cos(3.0 * t))
    coarse_s = 5.0 + 0.02 * np.repeat(np.arange(200), 2)  # a clock that advances with every second row
    columns = FileColumns(pa.table({"time_s": coarse_s, "displacement_m": x, "force_N": f}))
    (channel,) = import_table(table_of(columns, Path("press")), ImportOptions(fresh=True, runs=1)).channels
    assert channel.time_s == pytest.approx(t, abs=1e-6)
    assert not recovers_between_runs(session(62))
