"""A model beside the measurement: how far off it is, and where."""

import numpy as np
import pytest

from robot_io.errors import InputError
from tests.estimation.fits import MODEL, compare, cubic
from tests.estimation.presses import session


def test_comparison_says_where_a_stiffening_spring_is_missed():
    found = compare(session(4, cubic), MODEL)
    assert found.lack_of_fit > 3.0
    assert {"run", "direction", "speed", "depth", "effort"} <= set(found.parts)
    assert sum(part.energy for part in found.parts["run"]) == pytest.approx(1.0)
    deepest = found.parts["depth"][-1]
    assert deepest.mean > 0.0  # the measurement is above a straight line where it is deepest
    assert "times the noise" in found.words[0]
    assert any("depth" in words or "effort" in words for words in found.words[1:])


def test_comparison_of_a_complete_model_is_noise():
    found = compare(session(4), MODEL)
    assert found.lack_of_fit == pytest.approx(1.0, abs=0.05)
    assert "noise" in found.words[0]
    assert np.nanstd(found.fitted.residual) == pytest.approx(0.05, rel=0.1)


def test_what_is_not_judged_is_said_and_counts_nowhere():
    found = compare(session(4, cubic), MODEL)
    left_out = np.count_nonzero(~found.judged)
    assert np.array_equal(found.judged, np.isfinite(found.fitted.residual))
    assert 0 < left_out < 0.1 * len(found.judged)
    assert found.not_judged.startswith(f"{left_out:,} of {len(found.judged):,} samples (")
    assert sum(part.samples for part in found.parts["run"]) == np.count_nonzero(found.judged)
    assert found.not_judged in found._repr_html_()


def test_comparison_refuses_what_cannot_be_judged():
    with pytest.raises(InputError, match="samples"):
        compare(session(4).select(np.arange(20)), MODEL)
