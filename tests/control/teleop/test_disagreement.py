"""The leader says where its model and the follower's measurements part, and does not cry wolf."""

import numpy as np

from control.teleop.disagreement import Disagreement

RNG = np.random.default_rng(4)


def pressed(
    watch: Disagreement, place: str, real_n_m: float, model_n_m: float, noise_n: float = 0.02
) -> None:
    for depth_m in np.linspace(0.002, 0.012, 60):
        measured_n = real_n_m * depth_m + RNG.normal(0.0, noise_n)
        watch.add(place, depth_m, measured_n, model_n_m * depth_m)


def test_a_model_that_fits_raises_nothing():
    watch = Disagreement(noise_n=0.02)
    pressed(watch, "hold", 500.0, 500.0)
    pressed(watch, "loading", 500.0, 490.0)
    assert watch.found() == []


def test_a_harder_place_is_named_with_depth_and_size():
    watch = Disagreement(noise_n=0.02)
    pressed(watch, "soft", 500.0, 500.0)
    pressed(watch, "hard", 1000.0, 500.0)
    (misfit,) = watch.found()
    assert misfit.place == "hard"
    assert misfit.in_words().startswith("2.0 to 12.0 mm deep the virtual object is")
    assert 40.0 < 100.0 * misfit.share < 60.0
    assert "softer" in misfit.in_words()


def test_noise_alone_is_no_disagreement():
    watch = Disagreement(noise_n=0.5)
    pressed(watch, "hold", 100.0, 100.0, noise_n=0.5)
    assert watch.found() == []


def test_the_worst_comes_first_and_too_stiff_is_told_from_too_soft():
    watch = Disagreement()
    pressed(watch, "worse", 2000.0, 500.0)
    pressed(watch, "bad", 1000.0, 500.0)
    assert [misfit.place for misfit in watch.found()] == ["worse", "bad"]
    other = Disagreement()
    pressed(other, "stiff model", 500.0, 1000.0)
    assert "stiffer" in other.found()[0].in_words()
