"""Packages with drivers of the user's own."""

import importlib.util

from palpate.foreign_code import foreign_code
from robot_io.driver import DriverCatalogue
from robot_io.errors import InputError


def importable(packages: list[str]) -> tuple[str, ...]:
    """The packages, if Python finds them and they hold drivers.

    Raises:
        InputError: one is not found, fails, or holds no driver.
    """
    for package in packages:
        try:
            found = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            found = None
        if found is None:
            raise InputError(f"--drivers {package}: Python finds no such package (see PYTHONPATH)")
        with foreign_code(f"--drivers {package}"):
            own = _number_of_drivers(DriverCatalogue(package)) - _number_of_drivers(DriverCatalogue())
        if not own:
            raise InputError(f"--drivers {package}: holds no driver (docs/hardware.md says what one is)")
    return tuple(packages)


def _number_of_drivers(drivers: DriverCatalogue) -> int:
    return len(drivers.bus) + len(drivers.encoder) + len(drivers.torque) + len(drivers.force)
