"""A robot whose devices are opened; one that cannot be reached is said with the way out."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from palpate.words import as_shell_word
from robot_io.errors import DeviceError, InputError
from robot_io.robot import Robot
from robot_io.robot_file import RobotFile


@contextmanager
def opened(robot: Robot, robot_file: RobotFile) -> Iterator[None]:
    """Configure the robot, and close it at the end; it gets no power by this.

    Raises:
        InputError: a device that the robot file names could not be opened.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(robot)
        except DeviceError as error:
            word = as_shell_word(str(robot_file.path))
            raise InputError(
                f"{robot_file.path}: {error}; palpate doctor --robot {word} says what is there"
            ) from error
        yield
