"""What every driver keeps that can say what is connected."""

import numpy as np
import pytest

from robot_io.examination import Examinable, Level

MUST = {"odrive", "cubemars", "dynamixel"}  # the backends of hardware drivers, by the start of their names


@pytest.fixture
def examinable(bench, backend):
    """The configured robot's parts that can be examined."""
    bench.robot.configure()
    parts = [*bench.robot.buses.values(), bench.robot.encoder, bench.robot.torque, bench.robot.force]
    found = [part for part in parts if isinstance(part, Examinable)]
    if backend.name.split("_")[0] in MUST:
        assert any(part in bench.robot.buses.values() for part in found)
    if not found:
        pytest.skip("this backend has nothing to examine")
    return found


def test_looking_says_that_all_is_well_and_can_be_repeated_changes_nothing_and_powers_nothing(
    examinable, bench
):
    first = [part.examine() for part in examinable]
    for part, observations in zip(examinable, first, strict=True):
        wire_s = part.tick_wire_s()  # the bytes of a tick take some of its time
        assert wire_s is None or 0 < wire_s < bench.period_s
        assert observations
        for seen in observations:
            assert seen.level is Level.OK, seen
            assert seen.subject
            assert seen.text
            assert not seen.remedy
    bench.settle()
    assert np.isfinite(bench.read().joint_position_rad).all()
    again = [part.examine() for part in examinable]
    assert [[seen.subject for seen in found] for found in again] == [
        [seen.subject for seen in found] for found in first
    ]
    torque_nm = bench.read().joint_torque_nm
    assert np.abs(torque_nm).max() < 0.02 * max(bench.robot_file.limits.torque_nm)
    bench.robot.activate()  # as from any configured robot
    bench.tick()
