"""Effort and motion on two clocks."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data_quality import checklist, contaminated, quality_warnings
from palpate.estimation.data_quality.sampling import time_offset
from palpate.estimation.models import MODELS
from palpate.estimation.signals.blocks import number_pieces
from palpate.estimation.signals.runwise import shift
from tests.estimation.presses import kelvin_voigt, maxwell, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def with_motion(data, position, time_s=None):
    """The channel with another position, or other times, and derivatives of that."""
    time_s = data.time_s if time_s is None else time_s
    motion = differentiate(time_s, position, number_pieces(time_s, data.run))
    return replace(
        data, time_s=time_s, position=position, velocity=motion.velocity, acceleration=motion.acceleration
    )


def delayed(data, what, delay_s):
    late = shift(getattr(data, what), data.time_s, data.run, delay_s)
    return replace(data, effort=late) if what == "effort" else with_motion(data, late)


@pytest.mark.parametrize(
    ("what", "side", "delay_ms"),
    [("position", "early", 40.0), ("effort", "late", 4.0), ("effort", "late", 20.0)],
)
def test_report_states_size_and_direction_of_a_delay(what, side, delay_ms):
    data = delayed(session(3), what, 1e-3 * delay_ms)
    told = time_offset(data, MODEL)
    assert f"{side} relative to the motion: the error of kelvin_voigt is 0." in told
    assert float(told.split()[3]) == pytest.approx(delay_ms, abs=0.5)
    assert told in quality_warnings(data, MODEL)
    assert checklist(data, MODEL)["sync"] == told
    assert contaminated(data, MODEL) == told


LAWS = {
    "nothing": lambda t, x, v, run: kelvin_voigt(x, v),
    "a hardening spring": lambda t, x, v, run: kelvin_voigt(x, v, 4e6 * np.maximum(x, 0.0) ** 3),
    "slow relaxation": lambda t, x, v, run: kelvin_voigt(x, v, 400.0 * maxwell(t, x, run, 0.3)),
    "quick relaxation": lambda t, x, v, run: kelvin_voigt(x, v, 400.0 * maxwell(t, x, run, 0.02)),
    "friction": lambda t, x, v, run: kelvin_voigt(x, v, 0.5 * np.sign(v)),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_missing_effect_is_not_taken_for_a_delay(law, correlation):
    data = session(3, LAWS[law], correlation=correlation)
    assert time_offset(data, MODEL) is None
