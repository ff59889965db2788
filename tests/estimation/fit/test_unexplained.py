"""What is said of the error that a model leaves: that there is none, or which signals it depends on."""

from types import SimpleNamespace

import numpy as np
import pytest

from estimation.fit.exact import is_exact
from estimation.fit.unexplained import depends_on


@pytest.mark.parametrize(("rmse", "exact"), [(0.0, True), (2e-7, True), (2.1e-7, False)])
def test_single_precision_is_no_noise(rmse, exact):
    effort = np.array([2.0, -2.0, 2.0])
    assert is_exact(SimpleNamespace(data=SimpleNamespace(effort=effort), rmse=rmse)) is exact


@pytest.mark.parametrize(
    ("plain", "judged", "told"),
    [
        ({"velocity": 0.2, "time": 0.5, "load": 0.19}, {}, ["time", "velocity"]),  # 40 % of the most telling
        ({"velocity": 0.01, "time": 0.009}, {}, ["velocity"]),  # next to nothing is not told
        ({"velocity": 0.009, "time": 0.005}, {}, []),
        ({"velocity": 0.1, "time": 0.2}, {"velocity": 0.3, "time": 0.1}, ["velocity", "time"]),
        ({}, {}, []),
    ],
)
def test_signals_are_told_by_how_much_they_explain(plain, judged, told):
    by_signal = {name: judged.get(name, 0.0) for name in plain}
    standing = SimpleNamespace(
        flexible=SimpleNamespace(by_signal=plain), flexible_judged=SimpleNamespace(by_signal=by_signal)
    )
    assert depends_on(standing) == told
