"""Contract of every bus and driver, and of devices that can be examined."""

import inspect
import re
from contextlib import suppress

import numpy as np
import pytest

from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import DeviceTimeoutError
from palpate.robot_io.examination import Examinable, Level


def sample_times(robot):
    readings = (
        robot.encoder.read_position(),
        robot.encoder.read_velocity(),
        robot.torque.read_torque(),
        robot.force.read_force(),
    )
    return np.array([reading.sampled_at_s for reading in readings])


def test_only_polling_brings_new_samples(active):
    before = sample_times(active.robot)
    for _ in range(20):
        active.clock.sleep_until(active.clock.now_s() + active.period_s)
        for bus in active.robot.buses.values():
            bus.poll(active.clock.now_s() + active.period_s)
    polled = sample_times(active.robot)
    assert (polled > before).all()
    active.clock.sleep_until(active.clock.now_s() + 10 * active.period_s)
    np.testing.assert_array_equal(sample_times(active.robot), polled)


def test_late_repeated_polls_and_empty_flushes_are_harmless(active):
    for bus in active.robot.buses.values():
        before_s = active.clock.now_s()
        with suppress(DeviceTimeoutError):  # nothing had arrived: an honest answer
            bus.poll(before_s - 1.0)
        assert active.clock.now_s() - before_s < 5 * active.period_s
    assert (sample_times(active.robot) <= active.clock.now_s()).all()
    for _ in range(3):
        for bus in active.robot.buses.values():
            bus.poll(active.clock.now_s() + active.period_s)
    assert (sample_times(active.robot) <= active.clock.now_s()).all()
    active.tick()
    for bus in active.robot.buses.values():
        bus.flush(active.clock.now_s() + active.period_s)
        bus.flush(active.clock.now_s() + active.period_s)
    assert np.isfinite(active.tick().joint_position_rad).all()


CATALOGUE = DriverCatalog("palpate.sim_backend.drivers", "tests.mock_robot")
DRIVERS = [
    pytest.param(driver, id=name)
    for registry in (CATALOGUE.bus, CATALOGUE.encoder, CATALOGUE.torque, CATALOGUE.force)
    for name, driver in registry.items()
]


def test_registry_contains_every_kind_of_driver():
    assert {driver.id for driver in DRIVERS} >= {"mock_bus", "mock_encoder", "mock_torque", "mock_force"}


@pytest.mark.parametrize("driver", DRIVERS)
def test_driver_is_named_documented_and_built_from_settings(driver):
    assert re.fullmatch(r"[a-z][a-z0-9_]*", driver.name)
    assert inspect.getdoc(driver)
    assert list(inspect.signature(driver).parameters) == ["settings", "context"]


MUST = {"odrive", "cubemars", "dynamixel"}  # the backends of hardware drivers, by the start of their names


@pytest.fixture
def examinable(robot_setup, backend):
    """The configured robot's parts that can be examined."""
    robot_setup.robot.configure()
    parts = [
        *robot_setup.robot.buses.values(),
        robot_setup.robot.encoder,
        robot_setup.robot.torque,
        robot_setup.robot.force,
    ]
    found = [part for part in parts if isinstance(part, Examinable)]
    if backend.name.split("_")[0] in MUST:
        assert any(part in robot_setup.robot.buses.values() for part in found)
    if not found:
        pytest.skip("this backend has nothing to examine")
    return found


def test_examination_is_repeatable_without_changes_or_power(examinable, robot_setup):
    first = [part.examine() for part in examinable]
    for part, observations in zip(examinable, first, strict=True):
        wire_s = part.tick_wire_s()  # the bytes of a tick take some of its time
        assert wire_s is None or 0 < wire_s < robot_setup.period_s
        assert observations
        for seen in observations:
            assert seen.level is Level.OK, seen
            assert seen.subject
            assert seen.text
            assert not seen.remedy
    robot_setup.settle()
    assert np.isfinite(robot_setup.read().joint_position_rad).all()
    again = [part.examine() for part in examinable]
    assert [[seen.subject for seen in found] for found in again] == [
        [seen.subject for seen in found] for found in first
    ]
    torque_nm = robot_setup.read().joint_torque_nm
    assert np.abs(torque_nm).max() < 0.02 * max(robot_setup.robot_file.limits.torque_nm)
    robot_setup.robot.activate()  # as from any configured robot
    robot_setup.tick()
