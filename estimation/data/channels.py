"""The channels of sessions."""

from control.loop.tick_record import STREAM_NAME
from estimation.channel import ChannelData
from estimation.data.session_streams import imported_channels
from estimation.data.tick_channels import contact_channels, joined, joint_channels
from estimation.data.tick_check import checked_ticks
from estimation.signals.runwise import sample_time
from robot_io.errors import InputError
from robot_io.session import Session


def session_channels(session: Session, *more: Session, tared: bool = False) -> tuple[ChannelData, ...]:
    """The channels of a session, or of several probings by one arm: contact first, then the joints.

    Args:
        session: of a probing or an import.
        more: further probings by the same arm, which go on with the numbers of the runs.
        tared: take the force in free air off a contact's force, which is what a stiffness needs; else it is
            as it was measured, which is what the search for a sensor's bias needs. Imported channels stay
            as they are.

    Raises:
        InputError: the session has none, or there are several that do not belong together.
    """
    channels = imported_channels(session)
    if more or STREAM_NAME in session.stream_names:
        ticks = joined([checked_ticks(one) for one in _of_one_arm(session, *more)])
        channels = (*contact_channels(ticks, tared=tared), *joint_channels(ticks))
    if not channels:
        raise InputError(
            f"{session.path}: no stream holds samples of a run; its streams: "
            f"{', '.join(session.stream_names) or 'none'}"
        )
    for one in channels:
        if not sample_time(one.time_s, one.run) > 0.0:
            raise InputError(
                f"{session.path}: the times of '{one.name}' do not increase from sample to sample"
            )
    return channels


def _of_one_arm(*sessions: Session) -> tuple[Session, ...]:
    """The sessions, if one arm made them. InputError: one is no probing, or another arm's."""
    first = sessions[0]
    for one in sessions:
        if STREAM_NAME not in one.stream_names:
            raise InputError(f"{one.path}: is no probing, and cannot be joined with others")
        if one.metadata.urdf != first.metadata.urdf:
            raise InputError(f"{one.path}: was made by another arm than {first.path} (their URDFs differ)")
    return sessions
