"""Read sessions for a study: their channels, runs and arm."""

from itertools import chain
from pathlib import Path

import numpy as np

from palpate.control.loop.tick_record import STREAM_NAME
from palpate.estimation.base_model import Arm
from palpate.estimation.channel import ChannelData
from palpate.estimation.data.channels import run_labels, session_channels
from palpate.estimation.data.column_names import RUN
from palpate.estimation.data.import_file import chosen_texts
from palpate.estimation.data.tick_channels import MAY_LACK
from palpate.robot_io.calibration.applied import parse_calibrations
from palpate.robot_io.errors import InputError
from palpate.robot_io.robot_file import parse_robot_file
from palpate.robot_io.session import Session


def read_session(path: Path, runs: str) -> tuple[Session, tuple[ChannelData, ...]]:
    """Read the channels of one session.

    Args:
        path: path of the session.
        runs: only these, by number or by label in the imported data file, with commas between; "" for all.

    Raises:
        InputError: it cannot be read, or has no such run.
    """
    session = _open(path)
    channels = session_channels(session)
    if not runs:
        return session, channels
    # Number of each run by its label in the imported data file, and by its number. A number that is
    # another run's label is ambiguous and left out.
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
    """Read the probings in a folder as one measurement.

    Args:
        folder: folder of sessions by one arm.

    Raises:
        InputError: there is none, or they do not belong together.
    """
    sessions = [_open(path) for path in sorted(folder.glob("*.mcap"))]
    if not sessions:
        raise InputError(f"{folder}: is a folder without a session (.mcap) or a data file")
    return sessions, session_channels(*sessions)


def _open(path: Path) -> Session:
    """Open a session without the columns of ticks that no study needs, a third of a long session."""
    return Session.open(path).without_columns(STREAM_NAME, MAY_LACK)


def arm_of(session: Session) -> Arm:
    """Return the arm as a session describes it.

    Args:
        session: session of a probing or recording.

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
