"""The two ends of a CAN bus within one process."""

import os
from itertools import count
from typing import Any

import can

_numbers = count()


def open_virtual_bus(*, in_lock_step: bool) -> tuple[can.BusABC, dict[str, Any]]:
    """The devices' end, opened, and the driver's settings for the other.

    In lock-step frames carry the time of the simulated clock; else the wall clock's, as on a real adapter.
    """
    channel = f"palpate-{os.getpid()}-{next(_numbers)}"
    options: dict[str, Any] = {"preserve_timestamps": in_lock_step}
    bus = can.Bus(interface="virtual", channel=channel, **options)
    timestamps = "robot" if in_lock_step else "wall"
    return bus, {"interface": "virtual", "channel": channel, "options": options, "timestamps": timestamps}
