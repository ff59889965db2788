"""The channels of anything that a user may point at: a session or a data file."""

import os
from pathlib import Path

from control.loop.tick_record import STREAM_NAME
from estimation.channel import ChannelData
from estimation.data.import_file import import_file
from estimation.data.import_options import ImportOptions
from estimation.data.session_streams import imported_channels
from estimation.data.tick_channels import contact_channels, joint_channels
from estimation.data.tick_check import checked_ticks
from robot_io.errors import InputError
from robot_io.session import Session

_MCAP_MAGIC = b"\x89MCAP"
_DEFAULT = ImportOptions()


def is_session(path: str | os.PathLike[str]) -> bool:
    """Whether a file is or should be a session: by its ending, or by its first bytes."""
    place = Path(path)
    if place.suffix == ".mcap" or not place.is_file():
        return place.suffix == ".mcap"
    with place.open("rb") as file:
        return file.read(len(_MCAP_MAGIC)) == _MCAP_MAGIC


def session_channels(session: Session, *, tared: bool = False) -> tuple[ChannelData, ...]:
    """The channels of a session: contact first, then the joints.

    Args:
        session: of a probing or an import.
        tared: take the force in free air off a contact's force, which is what a stiffness needs; else it is
            as it was measured, which is what the search for a sensor's bias needs. Imported channels stay
            as they are.

    Raises:
        InputError: the session has none.
    """
    channels = imported_channels(session)
    if STREAM_NAME in session.stream_names:
        ticks = checked_ticks(session)
        channels = (*contact_channels(ticks, tared=tared), *joint_channels(ticks))
    if not channels:
        raise InputError(
            f"{session.path}: no channel with samples of a run; its streams: "
            f"{', '.join(session.stream_names) or 'none'}"
        )
    return channels


def load_channels(
    path: str | os.PathLike[str], options: ImportOptions = _DEFAULT, *, tared: bool = False
) -> tuple[ChannelData, ...]:
    """The channels of a session or of a data file.

    Args:
        path: either.
        options: for a data file.
        tared: see `session_channels`.

    Raises:
        InputError: it is neither, or has no channel.
        SessionError: the session cannot be read.
    """
    if is_session(path):
        return session_channels(Session.open(path), tared=tared)
    return import_file(path, options).channels
