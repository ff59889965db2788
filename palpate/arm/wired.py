"""Robots of real drivers whose devices are emulated: everything is as with hardware, down to the bytes."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import yaml

from robot_io.clock import Clock
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile, parse_robot_file
from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.emulators.faults import Faults
from sim_backend.emulators.wiring import WiredArm, wire_up
from sim_backend.scenario import Scenario

DEFAULT_SCENARIO = "default"
EMULATED = "simulated, emulated devices"  # what a session says of its source


def is_simulated(robot_file: RobotFile) -> bool:
    """Whether the robot's bus is a simulated world, without devices.

    Raises:
        InputError: it is, but there is another bus too: devices would be told the time of a simulation.
    """
    worlds = [name for name, bus in robot_file.buses.items() if bus.driver == PyBulletBus.name]
    others = [name for name in robot_file.buses if name not in worlds]
    if worlds and others:
        raise InputError(
            f"{robot_file.path}: bus '{worlds[0]}' is simulated ({PyBulletBus.name}) and bus '{others[0]}' "
            f"({robot_file.buses[others[0]].driver}) is not: simulated time passes as fast as can be, "
            "which no device could follow; let all be simulated, or none"
        )
    return bool(worlds)


def check_can_be_emulated(robot_file: RobotFile) -> None:
    """Refuse a robot that has no wires.

    Raises:
        InputError: its world is simulated without any.
    """
    if is_simulated(robot_file):
        raise InputError(
            f"robot '{robot_file.name}' is simulated without wires: --wire is for robots of hardware "
            "drivers, such as robots/dynamixel_3dof.yaml"
        )


def emulate(
    robot_file: RobotFile,
    scenario: Scenario,
    clock: Clock,
    *,
    as_built: RobotFile | None = None,
    faults: Mapping[str, Faults] | None = None,
) -> WiredArm:
    """Put emulated devices at the far end of every bus; close its bench at the end.

    Args:
        robot_file: a robot of hardware drivers.
        scenario: the world behind the devices, and what is hidden in it.
        clock: the robot's; on a simulated one the devices run in lock-step with it.
        as_built: what the devices really are; None: what the robot file says.
        faults: what goes wrong, by bus name.

    Raises:
        InputError: a bus cannot be emulated, or the two files do not have the same buses.
    """
    check_can_be_emulated(robot_file)
    if as_built is None:
        return wire_up(robot_file, scenario, clock, faults)
    check_can_be_emulated(as_built)
    if as_built.buses.keys() != robot_file.buses.keys():
        raise InputError(f"{as_built.path}: its buses are not those of {robot_file.path}")
    arm = wire_up(as_built, scenario, clock, faults)
    return replace(arm, robot_file=_led_to(robot_file, as_built, arm.robot_file))


def _led_to(robot_file: RobotFile, before: RobotFile, wired: RobotFile) -> RobotFile:
    """The robot file with those settings that lead to emulated devices."""
    data: Any = deepcopy(robot_file.document.data)
    for name, bus in wired.buses.items():
        known = before.buses[name].settings
        data["buses"][name].update(
            {key: value for key, value in bus.settings.items() if known.get(key) != value}
        )
    return parse_robot_file(yaml.safe_dump(data, sort_keys=False), robot_file.path)


def wires_in_words(robot_file: RobotFile) -> str:
    """What is emulated, such as "motors (dynamixel_bus), load_cell (serial_line); no hardware is touched".

    Raises:
        InputError: as `check_can_be_emulated`.
    """
    check_can_be_emulated(robot_file)
    buses = ", ".join(f"{name} ({bus.driver})" for name, bus in robot_file.buses.items())
    return f"{buses}; no hardware is touched"
