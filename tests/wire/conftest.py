"""Emulated robots that are closed at the end."""

import pytest

from palpate.robot_io.drivers.dynamixel.servos import DynamixelLine
from palpate.robot_io.drivers.feetech.servos import FeetechLine
from tests.wire.parts import EmulatedRobot


@pytest.fixture(autouse=True, scope="session")
def few_ids():
    """End a search for servos after 50 ms, which covers the ids of the emulated servos."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FeetechLine, "ping_all_s", 0.05)
        patch.setattr(DynamixelLine, "ping_all_s", 0.05)
        yield


@pytest.fixture
def make_robot():
    """Make emulated robots; close them all."""
    opened = []

    def make(*args, **kwargs):
        opened.append(EmulatedRobot(*args, **kwargs))
        return opened[-1]

    yield make
    for one in opened:
        one.close()
