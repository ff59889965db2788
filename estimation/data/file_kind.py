"""Tell sessions from other files by their first bytes."""

import os
from contextlib import suppress
from pathlib import Path

_MCAP_MAGIC = b"\x89MCAP"
_ROS = b"\x04\x00\x00\x00ros2"  # the profile, behind the magic number and the header's length
_HEAD_BYTES = 25


def is_session(path: str | os.PathLike[str]) -> bool:
    """Whether a file is or should be a session: by its ending, or by its first bytes.

    A recording of ROS 2 is an MCAP file too, but a data file like others.
    """
    place = Path(path)
    if not place.is_file():
        return place.suffix == ".mcap"
    head = b""
    with suppress(OSError), place.open("rb") as file:  # whoever reads it says what is wrong
        head = file.read(_HEAD_BYTES)
    mcap = head.startswith(_MCAP_MAGIC)
    return (mcap or place.suffix == ".mcap") and not (mcap and _ROS in head)
