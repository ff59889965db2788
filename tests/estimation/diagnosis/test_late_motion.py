"""Positions that are stamped late: a delay of the motion is one of the effort with the other sign."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.signals.runwise import shift
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.presses import session

KNOWN = ("delay", "lag", "cubic_stiffness")


def late(data, delay_s):
    """The same session, its motion reported `delay_s` later than it was."""
    motion = {
        name: shift(getattr(data, name), data.time_s, data.run, delay_s)
        for name in ("position", "velocity", "acceleration")
    }
    return replace(data, **motion)


@pytest.mark.parametrize("delay_s", [0.02, -0.02])
def test_a_motion_that_is_reported_late_or_early_is_found_with_its_sign(delay_s):
    effects = [EFFECTS[name]() for name in KNOWN]
    found = diagnose(late(session(4), delay_s), MODEL, effects, rng=np.random.default_rng(0)).channels[0]
    assert found.verdict is Verdict.MISSING
    (named,) = found.accepted
    assert named.effect == "delay"
    assert named.parameters["time"].value == pytest.approx(-delay_s, abs=0.001)
