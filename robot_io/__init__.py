"""The hardware abstraction: what is measured and commanded, drivers, robot file, clock, guard, session."""

from robot_io.driver import DriverCatalogue
from robot_io.robot import Robot, build_robot
from robot_io.robot_file import load_robot_file
from robot_io.session import Column, Samples, Session, SessionMetadata, SessionWriter, Stream, write_session

__all__ = [
    "Column",
    "DriverCatalogue",
    "Robot",
    "Samples",
    "Session",
    "SessionMetadata",
    "SessionWriter",
    "Stream",
    "build_robot",
    "load_robot_file",
    "write_session",
]
