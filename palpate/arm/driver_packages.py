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
        if package.endswith(".py"):
            raise InputError(f"--drivers {package}: give its name without .py (and its folder in PYTHONPATH)")
        if not _is_there(package):
            raise InputError(f"--drivers {package}: Python finds no such package (see PYTHONPATH)")
        with foreign_code(f"--drivers {package}"):
            own = _number_of_drivers(DriverCatalogue(package)) - _number_of_drivers(DriverCatalogue())
        if not own:
            raise InputError(f"--drivers {package}: holds no driver (docs/hardware.md says what one is)")
    return tuple(packages)


def _is_there(package: str) -> bool:
    """Whether Python finds it; the package around it is run for that."""
    with foreign_code(f"--drivers {package}"):
        try:
            return importlib.util.find_spec(package) is not None
        except ModuleNotFoundError as error:
            if error.name and f"{package}.".startswith(f"{error.name}."):
                return False
            raise
        except ValueError:
            return False


def _number_of_drivers(drivers: DriverCatalogue) -> int:
    return len(drivers.bus) + len(drivers.encoder) + len(drivers.torque) + len(drivers.force)
