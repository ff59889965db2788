"""Find robot files and drivers, and emulate devices for real drivers."""

import importlib.util
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.common.options import yaml_files
from palpate.common.user_effects import user_code
from palpate.robot_io.clock import Clock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import RobotFile, load_robot_file, replace_data
from palpate.sim_backend import ARMS
from palpate.sim_backend.drivers import SimulatedBus
from palpate.sim_backend.emulators.wiring import WiredArm, wire_up
from palpate.sim_backend.scenario import Scenario

DEFAULT = "follower"
DEFAULT_SCENARIO = "default"
EMULATED = "simulated, emulated devices"  # source stated in the session


def shipped_robots() -> dict[str, Path]:
    """Return the robot files that come with palpate, by name."""
    return {path.parent.name: path for path in sorted(ARMS.glob("*/*.yaml")) if path.stem == path.parent.name}


def robot_names() -> list[str]:
    """Return the shipped arms, and the user's own files, for shell completion."""
    return [*shipped_robots(), *yaml_files()]


def find_robot(robot: str) -> RobotFile:
    """Load a robot file.

    Args:
        robot: name of a shipped arm, or path of a robot file.

    Raises:
        InputError: there is no such file, or it is invalid.
    """
    shipped = shipped_robots()
    path = shipped.get(robot, Path(robot))
    if not path.is_file():
        names = ", ".join(shipped)
        raise InputError(f"robot '{robot}': no such robot file. Shipped robots: {names}")
    return load_robot_file(path)


def importable(packages: list[str]) -> tuple[str, ...]:
    """Return the package names if Python finds the packages and they contain drivers.

    Args:
        packages: dotted names of packages; importing them runs their code.

    Raises:
        InputError: a package is not found, fails to import, or contains no driver.
    """
    for package in packages:
        if package.endswith(".py"):
            raise InputError(f"--drivers {package}: give its name without .py (and its folder in PYTHONPATH)")
        exists = False
        with user_code(f"--drivers {package}"):  # the search imports its parent packages
            try:
                exists = importlib.util.find_spec(package) is not None
            except ModuleNotFoundError as error:
                if not (error.name and f"{package}.".startswith(f"{error.name}.")):
                    raise
            except ValueError:
                pass
        if not exists:
            raise InputError(f"--drivers {package}: Python finds no such package (see PYTHONPATH)")
        with user_code(f"--drivers {package}"):
            own = _number_of_drivers(DriverCatalog(package)) - _number_of_drivers(DriverCatalog())
        if not own:
            raise InputError(f"--drivers {package}: holds no driver (docs/how-to/driver.md explains drivers)")
    return tuple(packages)


def _number_of_drivers(drivers: DriverCatalog) -> int:
    return len(drivers.bus) + len(drivers.encoder) + len(drivers.torque) + len(drivers.force)


def is_simulated(robot_file: RobotFile) -> bool:
    """Return whether the robot's bus is a simulated world, without devices.

    Args:
        robot_file: robot file of the robot.

    Raises:
        InputError: the robot has both a simulated and another bus, whose devices would run on simulated time.
    """
    worlds = [name for name, bus in robot_file.buses.items() if bus.driver == SimulatedBus.name]
    others = [name for name in robot_file.buses if name not in worlds]
    if worlds and others:
        raise InputError(
            f"{robot_file.path}: bus '{worlds[0]}' is simulated ({SimulatedBus.name}) and bus '{others[0]}' "
            f"({robot_file.buses[others[0]].driver}) is not. Simulated time runs faster than any "
            "device can follow; simulate all buses, or none"
        )
    return bool(worlds)


def check_can_be_emulated(robot_file: RobotFile) -> None:
    """Raise `InputError` if the robot's world is simulated without device protocols."""
    if is_simulated(robot_file):
        raise InputError(
            f"robot '{robot_file.name}' is simulated without devices, but --wire needs a robot file with "
            "hardware drivers, such as robots/dynamixel_3dof.yaml"
        )


def emulate(
    robot_file: RobotFile, scenario: Scenario, clock: Clock, *, as_built: RobotFile | None = None
) -> WiredArm:
    """Connect emulated devices to every bus of a robot; the caller must close its emulator.

    On a simulated clock the devices run in lockstep with the clock.

    Args:
        robot_file: robot file of the robot.
        scenario: the world behind the devices.
        clock: clock of the devices.
        as_built: robot file of the emulated arm; None for `robot_file`.

    Raises:
        InputError: a bus cannot be emulated, or the two files do not have the same buses.
    """
    check_can_be_emulated(robot_file)
    if as_built is None:
        return wire_up(robot_file, scenario, clock)
    check_can_be_emulated(as_built)
    built, expected = (
        {name: bus.driver for name, bus in file.buses.items()} for file in (as_built, robot_file)
    )
    if built != expected:
        raise InputError(f"{as_built.path}: has buses {built}, but {robot_file.path} has {expected}")
    arm = wire_up(as_built, scenario, clock)
    data: Any = deepcopy(robot_file.document.data)
    for name, bus in arm.robot_file.buses.items():  # only the addresses of devices change
        known = as_built.buses[name].settings.items()
        data["buses"][name].update(dict(item for item in bus.settings.items() if item not in known))
    return replace(arm, robot_file=replace_data(robot_file, data))


def describe_wires(robot_file: RobotFile) -> str:
    """Describe emulated buses, such as "motors (dynamixel_bus), load_cell (serial_line)"."""
    check_can_be_emulated(robot_file)
    buses = ", ".join(f"{name} ({bus.driver})" for name, bus in robot_file.buses.items())
    return f"{buses}; no hardware is touched"
