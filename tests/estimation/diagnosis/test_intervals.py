"""Intervals where the acceleration is derived, and therefore wrong."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.fit.acceleration_doubt import doubted
from estimation.fit.intervals import Value, final, values
from estimation.fit.standing import stand
from estimation.models import MODELS

STEP_S, INERTIA = 0.002, 0.05


def swinging(*, smoothed: float, uneven: bool = False) -> ChannelData:
    """A mass on a joint, swung at three frequencies in each of four runs."""
    rng = np.random.default_rng(3)
    parts: dict[str, list[np.ndarray]] = {name: [] for name in ("t", "x", "v", "a", "run")}
    for run in range(4):
        t = 6.0 * run + STEP_S * np.arange(2500)
        if uneven:
            t = t + rng.uniform(-0.3, 0.3, len(t)) * STEP_S
        turns = [(2 * np.pi * f, rng.uniform(0, 6.28)) for f in (0.4, 1.1, 2.3)]
        parts["t"].append(t)
        parts["x"].append(sum(0.5 / w * np.sin(w * t + p) for w, p in turns))
        parts["v"].append(sum(0.5 * np.cos(w * t + p) for w, p in turns))
        parts["a"].append(sum(-0.5 * w * np.sin(w * t + p) for w, p in turns))
        parts["run"].append(np.full(len(t), run))
    t, x, v, a, run = (np.concatenate(part) for part in parts.values())
    effort = INERTIA * a + 0.1 * v + rng.normal(0.0, 0.002, len(t))
    if smoothed:
        for number in range(4):
            a[run == number] = gaussian_filter1d(a[run == number], smoothed / STEP_S)
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, x, v, a, effort, run, np.full(len(t), -1))


def mass(data: ChannelData) -> Value:
    model = MODELS["inertia"]().build(ModelContext())
    return values(*final(stand(data, model, {}), complete=True))["inertia.m"]


def test_an_interval_holds_the_mass_though_the_acceleration_was_smoothed() -> None:
    exact, smoothed = mass(swinging(smoothed=0.0)), mass(swinging(smoothed=0.015))
    assert abs(exact.value - INERTIA) < 3.0 * exact.std_err < 0.01 * INERTIA
    assert smoothed.value - INERTIA > 5.0 * exact.std_err  # peaks are cut, so that the mass seems larger
    assert abs(smoothed.value - INERTIA) < 1.96 * smoothed.std_err < 0.1 * INERTIA


@pytest.mark.parametrize("uneven", [False, True])
def test_positions_tell_what_a_smoothed_acceleration_lacks(uneven: bool) -> None:
    true, smoothed = swinging(smoothed=0.0, uneven=uneven), swinging(smoothed=0.02, uneven=uneven)
    inner = slice(100, 2400)
    lacking = (true.acceleration - smoothed.acceleration)[inner]
    found = (doubted(smoothed).acceleration - smoothed.acceleration)[inner]
    assert np.sqrt(np.mean((found - lacking) ** 2)) < 0.15 * np.sqrt(np.mean(lacking**2))


def test_a_run_too_short_to_tell_is_left_as_it_is() -> None:
    data = swinging(smoothed=0.02)
    few = data.select(np.arange(len(data)) < 10)
    np.testing.assert_array_equal(doubted(few).acceleration, few.acceleration)
    one = replace(few).select(np.arange(10) < 1)
    np.testing.assert_array_equal(doubted(one).acceleration, one.acceleration)
