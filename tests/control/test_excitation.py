"""The excitation's profile: smooth, within bounds, at the frequencies asked for."""

import numpy as np
import pytest
from pydantic import ValidationError

from control.paths.excitation import Excitation, Profile, position_amplitude_m

STEP_S = 1e-5
SHAPES = ["multisine", "chirp"]


def values(profile: Profile, step_s: float = 1e-3) -> np.ndarray:
    times = np.arange(0.0, profile.duration_s, step_s)
    return np.array([profile.at(time_s).value for time_s in times])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("offset", [1.0, 3.0])
def test_it_begins_at_rest_and_only_takes_away(shape, offset):
    profile = Profile(Excitation(shape=shape), offset)
    start = profile.at(0.0)
    assert start.value == start.rate_1_s == start.acceleration_1_s2 == 0.0
    found = values(profile)
    assert found.max() <= 1e-3
    assert found.min() >= -offset - 1.0 - 1e-3
    assert np.ptp(found[1000:]) > 1.5


@pytest.mark.parametrize("shape", SHAPES)
def test_rate_and_acceleration_are_derivatives(shape):
    profile = Profile(Excitation(shape=shape))
    for time_s in np.linspace(0.01, 3.9, 60):
        behind, now, ahead = (profile.at(time_s + s) for s in (-STEP_S, 0.0, STEP_S))
        assert now.rate_1_s == pytest.approx((ahead.value - behind.value) / (2 * STEP_S), abs=1e-4)
        bend = (ahead.rate_1_s - behind.rate_1_s) / (2 * STEP_S)
        assert now.acceleration_1_s2 == pytest.approx(bend, abs=0.02)


@pytest.mark.parametrize("shape", SHAPES)
def test_its_power_lies_between_the_frequencies(shape):
    excitation = Excitation(shape=shape, low_hz=1.0, high_hz=6.0, duration_s=8.0)
    found = values(Profile(excitation))[round(excitation.ramp_s * 500) :]  # from half way into the fade
    power = np.abs(np.fft.rfft(found - found.mean())) ** 2
    hertz = np.fft.rfftfreq(len(found), 1e-3)
    assert power[hertz > 7.0].sum() / power.sum() < 0.01
    assert power[hertz < 0.8].sum() / power.sum() < 0.5
    for low, high in ((0.9, 2.2), (2.2, 4.0), (4.0, 6.2)):
        assert power[(hertz > low) & (hertz < high)].sum() / power.sum() > 0.05


def test_position_and_force_amplitude_fit_the_object():
    excitation = Excitation(amplitude_n=1.5, high_hz=8.0)
    stiff, offset = position_amplitude_m(
        excitation, stiffness_n_m=7100.0, damping_n_s_m=0.0, force_limit_n=10.0, speed_limit_m_s=0.15
    )
    assert stiff == pytest.approx(1.5 / 7100.0)
    assert offset == 1.0
    soft, _ = position_amplitude_m(
        excitation, stiffness_n_m=100.0, damping_n_s_m=0.0, force_limit_n=10.0, speed_limit_m_s=0.15
    )
    assert soft * 2 * np.pi * 8.0 <= 0.15 + 1e-12  # the speed limit, not 15 mm
    damped, offset = position_amplitude_m(
        excitation, stiffness_n_m=500.0, damping_n_s_m=50.0, force_limit_n=10.0, speed_limit_m_s=0.15
    )
    assert offset > 1.0
    assert damped * np.hypot(500.0, 2 * np.pi * 8.0 * 50.0) <= 1.5 + 1e-9


@pytest.mark.parametrize(
    "changes", [{"low_hz": 9.0}, {"amplitude_n": 0.0}, {"duration_s": 1.0}, {"shape": "square"}, {"amp": 1}]
)
def test_nonsense_is_refused(changes):
    with pytest.raises(ValidationError):
        Excitation(**changes)
