"""Robots of real drivers whose devices are emulated: everything is as with hardware, down to the bytes."""

from robot_io.clock import Clock
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile
from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.emulators.wiring import WiredArm, wire_up
from sim_backend.scenario import Scenario

DEFAULT_SCENARIO = "default"
EMULATED = "simulated, emulated devices"  # what a session says of its source


def check_can_be_emulated(robot_file: RobotFile) -> None:
    """Refuse a robot that has no wires.

    Raises:
        InputError: its world is simulated without any.
    """
    if any(bus.driver == PyBulletBus.name for bus in robot_file.buses.values()):
        raise InputError(
            f"robot '{robot_file.name}' is simulated without wires: --wire is for robots of hardware "
            "drivers, such as robots/dynamixel_3dof.yaml"
        )


def emulate(robot_file: RobotFile, scenario: Scenario, clock: Clock) -> WiredArm:
    """Put emulated devices at the far end of every bus; close its bench at the end.

    Args:
        robot_file: a robot of hardware drivers.
        scenario: the world behind the devices, and what is hidden in it.
        clock: the robot's; on a simulated one the devices run in lock-step with it.

    Raises:
        InputError: a bus cannot be emulated.
    """
    check_can_be_emulated(robot_file)
    return wire_up(robot_file, scenario, clock)


def wires_in_words(robot_file: RobotFile) -> str:
    """What is emulated, such as "motors (dynamixel_bus), load_cell (serial_line); no hardware is touched".

    Raises:
        InputError: as `check_can_be_emulated`.
    """
    check_can_be_emulated(robot_file)
    buses = ", ".join(f"{name} ({bus.driver})" for name, bus in robot_file.buses.items())
    return f"{buses}; no hardware is touched"
