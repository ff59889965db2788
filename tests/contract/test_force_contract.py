"""Contract of every force sensor."""

import pytest


def test_free_air_is_about_zero(active):
    assert abs(active.tick().force_n) < 1.0


def test_compression_is_positive(active):
    if active.press is None:
        pytest.skip("nobody can press this sensor")
    active.press(5.0)
    pressed_n = [active.tick().force_n for _ in range(10)][-1]
    active.press(0.0)
    released_n = [active.tick().force_n for _ in range(10)][-1]
    assert pressed_n == pytest.approx(5.0, abs=0.3)
    assert released_n == pytest.approx(0.0, abs=0.3)
