"""What is said of the error that a model leaves: that there is none, or which signals it depends on."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimation.fit.fit_result import FitResult


@pytest.mark.parametrize(("rmse", "exact"), [(0.0, True), (2e-7, True), (2.1e-7, False)])
def test_single_precision_is_no_noise(rmse, exact):
    effort = np.array([2.0, -2.0, 2.0])
    fit = SimpleNamespace(training=SimpleNamespace(effort=effort), rmse=rmse)
    assert FitResult.is_exact.fget(fit) is exact


@pytest.mark.parametrize(
    ("shares", "told"),
    [
        ({"velocity": 0.2, "time": 0.5, "load": 0.19}, ["time", "velocity"]),  # 40 % of the most telling
        ({"velocity": 0.01, "time": 0.009}, ["velocity"]),  # next to nothing is not told
        ({"velocity": 0.009, "time": 0.005}, []),
        ({}, []),
    ],
)
def test_signals_are_told_by_how_much_they_explain(shares, told):
    assert FitResult.depends_on.fget(SimpleNamespace(flexible=SimpleNamespace(by_signal=shares))) == told
