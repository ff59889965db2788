"""Every driver has the same form, whatever device it drives."""

import inspect
import re

import pytest

from robot_io.driver import DriverCatalogue

CATALOGUE = DriverCatalogue("sim_backend.drivers", "tests.mock_robot")
DRIVERS = [
    pytest.param(driver, id=name)
    for registry in (CATALOGUE.bus, CATALOGUE.encoder, CATALOGUE.torque, CATALOGUE.force)
    for name, driver in registry.items()
]


def test_every_kind_of_driver_is_found():
    assert {driver.id for driver in DRIVERS} >= {"mock_bus", "mock_encoder", "mock_torque", "mock_force"}


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_driver_is_named_documented_and_made_from_settings_and_context(driver):
    assert re.fullmatch(r"[a-z][a-z0-9_]*", driver.name)
    assert inspect.getdoc(driver)
    assert list(inspect.signature(driver).parameters) == ["settings", "context"]
