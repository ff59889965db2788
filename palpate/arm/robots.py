"""Finds a robot file by the name of a shipped arm or by its path."""

from pathlib import Path

import sim_backend
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile, load_robot_file

ARMS = Path(sim_backend.__file__).parent / "arms"
DEFAULT = "follower"


def shipped_robots() -> dict[str, Path]:
    """Robot files that come with palpate, by name."""
    return {path.parent.name: path for path in sorted(ARMS.glob("*/*.yaml")) if path.stem == path.parent.name}


def find_robot(robot: str) -> RobotFile:
    """Read the robot file that the user means.

    Args:
        robot: name of a shipped arm, or path of a robot file.

    Raises:
        InputError: there is no such arm or file, or the file is not valid.
    """
    shipped = shipped_robots()
    if robot in shipped:
        return load_robot_file(shipped[robot])
    path = Path(robot)
    if not path.is_file():
        names = ", ".join(shipped)
        raise InputError(f"robot '{robot}': no such robot file, and those shipped are {names}")
    return load_robot_file(path)
