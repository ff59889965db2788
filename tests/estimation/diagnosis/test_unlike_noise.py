"""What no signal explains and yet is no noise: free air shows how large the noise is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from estimation.diagnosis.judgement.unlike_noise import unlike_noise

from estimation.diagnosis import Verdict, diagnose
from estimation.fit.standing import stand
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.fits import compare
from tests.estimation.presses import NOISE_N, kelvin_voigt, session


def humming(t, x, v, run):
    """Hum of 7.3 Hz that is there in contact only."""
    return kelvin_voigt(x, v, extra=0.4 * np.sin(2 * np.pi * 7.3 * t))


def test_hum_is_not_called_adequate_and_its_frequency_is_told():
    data = session(2, humming)
    found = diagnose(data, MODEL, rng=np.random.default_rng(0)).channels[0]
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert found.depends_on == ["time"]
    told_hz = float(re.search(r"swings at ([\d.]+) Hz", found.reason)[1])
    assert told_hz == pytest.approx(7.3, rel=0.01)
    assert found.noise_floor == pytest.approx(NOISE_N, rel=0.1)


def test_a_comparison_does_not_call_it_noise_either():
    told = compare(session(2, humming), MODEL)
    assert told.lack_of_fit > 3.0
    assert "times the noise floor" in told.words[0]


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.97])
def test_noise_as_in_free_air_is_noise_whatever_its_colour(correlation):
    for seed in range(4):
        assert unlike_noise(stand(session(seed, correlation=correlation), MODEL, {})) is None


def test_noise_that_grows_with_the_load_is_noise():
    data = session(3)
    louder = np.random.default_rng(1).normal(0.0, 1.0, len(data)) * 0.05 * np.abs(data.effort)
    assert unlike_noise(stand(replace(data, effort=data.effort + louder), MODEL, {})) is None


def test_the_steps_of_a_coarse_encoder_are_expected():
    data = session(3)
    step_m = 3e-4
    coarse = replace(data, position=step_m * np.round(data.position / step_m))
    assert unlike_noise(stand(coarse, MODEL, {})) is None
