"""Emulated robots that are closed at the end."""

from contextlib import suppress

import pytest

from palpate.robot_io.drivers.dynamixel.servos import DynamixelLine
from palpate.robot_io.drivers.feetech.servos import FeetechLine
from palpate.robot_io.errors import DeviceError
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
    """Make emulated robots; close them all, also those whose devices no longer answer."""
    opened = []

    def make(*args, **kwargs):
        opened.append(EmulatedRobot(*args, **kwargs))
        return opened[-1]

    yield make
    for one in opened:
        with suppress(DeviceError):
            one.robot.close()
        one.arm.emulator.close()
