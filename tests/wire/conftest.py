"""Benches that are closed at the end."""

from contextlib import suppress

import pytest

from palpate.robot_io.errors import DeviceError
from tests.wire.parts import WireBench


@pytest.fixture
def bench():
    """Makes benches; closes them all, also those whose devices no longer answer."""
    opened = []

    def make(*args, **kwargs):
        opened.append(WireBench(*args, **kwargs))
        return opened[-1]

    yield make
    for one in opened:
        with suppress(DeviceError):
            one.robot.close()
        one.arm.bench.close()
