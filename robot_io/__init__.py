"""The hardware abstraction: what is measured and commanded, drivers, robot file, clock, guard, session."""

from robot_io.clock import Clock, MonotonicClock, SimulatedClock
from robot_io.driver import DriverCatalogue, DriverContext
from robot_io.errors import (
    DeviceError,
    DeviceTimeoutError,
    InputError,
    LifecycleError,
    PalpateError,
    SafetyTripError,
    SessionError,
    UnknownNameError,
)
from robot_io.guard import Guard, Limits, SafeState, Trip
from robot_io.interfaces import Bus, Component, ForceSensor, JointEncoder, JointTorque
from robot_io.registry import Registry
from robot_io.robot import Robot, RobotState, build_robot
from robot_io.robot_file import RobotFile, load_robot_file, parse_robot_file
from robot_io.session import (
    Column,
    Event,
    Samples,
    Session,
    SessionMetadata,
    SessionWriter,
    Stream,
    write_session,
)
from robot_io.types import Command, Measurement, Reading, Status, frozen_array

__all__ = [
    "Bus",
    "Clock",
    "Column",
    "Command",
    "Component",
    "DeviceError",
    "DeviceTimeoutError",
    "DriverCatalogue",
    "DriverContext",
    "Event",
    "ForceSensor",
    "Guard",
    "InputError",
    "JointEncoder",
    "JointTorque",
    "LifecycleError",
    "Limits",
    "Measurement",
    "MonotonicClock",
    "PalpateError",
    "Reading",
    "Registry",
    "Robot",
    "RobotFile",
    "RobotState",
    "SafeState",
    "SafetyTripError",
    "Samples",
    "Session",
    "SessionError",
    "SessionMetadata",
    "SessionWriter",
    "SimulatedClock",
    "Status",
    "Stream",
    "Trip",
    "UnknownNameError",
    "build_robot",
    "frozen_array",
    "load_robot_file",
    "parse_robot_file",
    "write_session",
]
