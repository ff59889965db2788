"""Mutated frames into both sides: none that was damaged is taken, and none crashes anything."""

import pytest

from benchmarks.teleop.fuzz import fuzz


@pytest.mark.parametrize("seed", [2, 3])
def test_no_damaged_frame_moves_the_arm_or_is_felt(seed):
    result = fuzz(1000, seed, mended=False)
    assert result.counts["refused as malformed"] == 2000  # on both sides
    assert result.targets == set()
    assert result.felt == 0


def test_frames_with_a_checksum_that_fits_crash_neither_side():
    """Whoever makes these can as well send whole ones: that is what certificates, plan and guard are for."""
    result = fuzz(1000, 2, mended=True)
    assert result.counts["refused as malformed"] > 1500
    for target in result.targets:
        assert all(abs(value) <= 100.0 for value in target.position_world_m)
