"""Read the channels, runs and arm of sessions for a study."""

from itertools import chain
from pathlib import Path

import numpy as np

from palpate.control.loop.tick_record import STREAM_NAME
from palpate.estimation.base_model import Arm
from palpate.estimation.channel import ChannelData
from palpate.estimation.data.channels import run_labels, session_channels
from palpate.estimation.data.column_names import RUN
from palpate.estimation.data.import_file import chosen_texts
from palpate.estimation.data.tick_channels import USED_COLUMNS
from palpate.robot_io.calibration.applied import parse_calibrations
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.session import Session


def read_session(path: Path, runs: str) -> tuple[Session, tuple[ChannelData, ...]]:
    """Read the channels of one session.

    Args:
        path: path of the session.
        runs: numbers or labels of the runs to read, separated by commas; "" for all.

    Raises:
        InputError: the session cannot be read, or has no such run.
    """
    session = _open(path)
    channels = session_channels(session)
    if not runs:
        return session, channels
    # Map labels of the imported data file and run numbers to run numbers. A number that is the label of
    # another run is ambiguous and excluded.
    recorded = sorted(set(chain(*(channel.runs.tolist() for channel in channels))))
    runs_by_label = {label: run for label, run in run_labels(session).items() if run in recorded}
    unnamed = {str(run): run for run in recorded}
    known = {
        name: run
        for name, run in (unnamed | runs_by_label).items()
        if unnamed.get(name, run) == runs_by_label.get(name, run)
    }
    numbers = np.array([known[text] for text in chosen_texts(RUN, runs, known, str(path))])
    chosen = (channel.of_runs(numbers) for channel in channels)
    return session, tuple(channel for channel in chosen if len(channel))


def read_folder(folder: Path) -> tuple[list[Session], tuple[ChannelData, ...]]:
    """Read the probing sessions in a folder as one measurement.

    Args:
        folder: folder with sessions of one arm.

    Raises:
        InputError: the folder has no session, or the sessions cannot be joined.
    """
    sessions = [_open(path) for path in sorted(folder.glob("*.mcap"))]
    if not sessions:
        raise InputError(f"{folder}: is a folder without a session (.mcap) or a data file")
    return sessions, session_channels(*sessions)


def without_ticks(session: Session) -> Session:
    """Return a session with only the joint positions of its ticks, which frees most of its memory.

    Args:
        session: a session from `read_session` or `read_folder`.
    """
    return session.read_columns(STREAM_NAME, ("joint_position_rad",))


def with_ticks(session: Session) -> Session:
    """Return a session with all needed columns, read again after `without_ticks`.

    Args:
        session: session from `read_session` or `read_folder`; returned itself if its columns are complete.

    Raises:
        InputError: the session cannot be read any more, or its file holds another session now.
    """
    if STREAM_NAME not in session.stream_names or "run" in session.samples(STREAM_NAME):
        return session
    opened = _open(session.path)
    if opened.metadata != session.metadata:
        raise InputError(f"{session.path}: holds a different session than before; start again")
    return opened


def _open(path: Path) -> Session:
    """Open a session without tick columns that no study needs, which halves its memory."""
    return Session.open(path).read_columns(STREAM_NAME, USED_COLUMNS)


def arm_of(session: Session) -> Arm:
    """Return the arm described by a session.

    Args:
        session: session of a probing or a recording.

    Raises:
        InputError: the session's copy of the robot file or calibration is not valid.
    """
    text = session.metadata.robot_file
    robot_file = parse_robot_file(text, f"{session.path}, its robot file") if text else None
    tip_frame = robot_file.tip_frame if robot_file else ""
    rotors = robot_file.rotor_inertia_kg_m2 if robot_file else None
    calibrations = parse_calibrations(session.metadata.calibration, f"{session.path}, its calibration")
    origin = f"{session.path}, its URDF"
    return Arm(session.metadata.urdf, tip_frame, origin, calibrations.gravity_base_m_s2, rotors or ())
