"""The leader says where its model and the follower's measurements part, and does not cry wolf."""

import numpy as np

from control.teleop.force_mismatch import MismatchMonitor

RNG = np.random.default_rng(4)


def pressed(
    monitor: MismatchMonitor, place: str, real_n_m: float, model_n_m: float, noise_n: float = 0.02
) -> None:
    for depth_m in np.linspace(0.002, 0.012, 60):
        measured_n = real_n_m * depth_m + RNG.normal(0.0, noise_n)
        monitor.add(place, depth_m, measured_n, model_n_m * depth_m)


def test_a_model_that_fits_raises_nothing():
    monitor = MismatchMonitor(noise_n=0.02)
    pressed(monitor, "hold", 500.0, 500.0)
    pressed(monitor, "loading", 500.0, 490.0)
    assert monitor.mismatches() == []


def test_a_harder_place_is_named_with_depth_and_size():
    monitor = MismatchMonitor(noise_n=0.02)
    pressed(monitor, "soft", 500.0, 500.0)
    pressed(monitor, "hard", 1000.0, 500.0)
    (misfit,) = monitor.mismatches()
    assert misfit.place == "hard"
    assert misfit.summary().startswith("2.0 to 12.0 mm deep the virtual object is")
    assert 40.0 < 100.0 * misfit.share < 60.0
    assert "softer" in misfit.summary()


def test_noise_alone_is_no_disagreement():
    monitor = MismatchMonitor(noise_n=0.5)
    pressed(monitor, "hold", 100.0, 100.0, noise_n=0.5)
    assert monitor.mismatches() == []


def test_the_worst_comes_first_and_too_stiff_is_told_from_too_soft():
    monitor = MismatchMonitor()
    pressed(monitor, "worse", 2000.0, 500.0)
    pressed(monitor, "bad", 1000.0, 500.0)
    assert [misfit.place for misfit in monitor.mismatches()] == ["worse", "bad"]
    other = MismatchMonitor()
    pressed(other, "stiff model", 500.0, 1000.0)
    assert "stiffer" in other.mismatches()[0].summary()
