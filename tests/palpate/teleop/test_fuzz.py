"""Mutated frames to both sides: damaged ones are refused, and none crashes a side."""

import os

import pytest

from palpate.robot_io.link.frame import CHECKSUM, key_seal
from palpate.robot_io.link.messages import Target
from tests.palpate.teleop.driven import drive
from tests.palpate.teleop.link_fuzz import fuzz

DOWN = (0.0, 0.0, -1.0)
FRAMES = int(os.environ.get("PALPATE_FUZZ_INPUTS", "1000"))
OURS = key_seal(b"of the pair")


@pytest.mark.parametrize(
    ("seed", "seals"),
    [(2, (CHECKSUM, None)), (3, (OURS, None)), (3, (OURS, CHECKSUM)), (2, (OURS, key_seal(b"no")))],
)
def test_damaged_and_unauthenticated_frames_have_no_effect(seed, seals):
    result = fuzz(FRAMES, seed, *seals)
    assert result.counts["refused as malformed"] == 2 * FRAMES  # on both sides
    assert result.targets == set()
    assert result.rendered == 0


def test_valid_checksum_frames_crash_neither_side():
    """Whoever makes these can as well send whole ones: that is what a key, plan and guard are for."""
    result = fuzz(FRAMES, 2, CHECKSUM, CHECKSUM)
    assert result.counts["refused as malformed"] > 1.5 * FRAMES
    for target in result.targets:
        assert all(abs(value) <= 100.0 for value in target.position_world_m)


def test_arbitrary_targets_keep_the_arm_within_its_limits(tmp_path):
    """One that can be probed, and what no arm can do: each is refused, and none trips the guard."""
    odd = [(0.4, 0.0, 0.05), (99.0, 0.0, 0.05), (0.0, 0.0, 0.0), (0.3, 0.0, 1e-300)]
    directions = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.0, -0.8), (0.0, 0.0, 1.0)]
    targets = [Target(0, place, DOWN) for place in odd] + [Target(0, odd[0], one) for one in directions]
    driven = drive(targets, tmp_path)
    assert driven.finished
    assert driven.states.total() == len(targets)
    assert driven.states["done"] >= 1
    assert driven.states["refused"] >= 4
    assert max(driven.position, driven.velocity, driven.force) < 1.0
