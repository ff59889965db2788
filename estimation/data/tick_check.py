"""Looks at a session's ticks before anybody uses them: a session is a stranger's file, as any CSV file is."""

import numpy as np

from control.loop.task import NO_RUN, Phase
from control.loop.tick_record import STREAM_NAME, tick_stream
from estimation.data.numbers import fault_of, more_like_it, useless_rows
from robot_io.errors import InputError, SessionError
from robot_io.session import Column, Samples, Session
from robot_io.types import BoolArray, Status

USELESS = (Phase.IDLE, Phase.STOPPED)
_MOST_JOINTS = 100
_FAR_S = 60.0  # between a tick and a sample in it, which no age limit allows
_MAY_LACK = {  # what nothing is worked out from
    "tick",
    "guard_tripped",
    *("joint_velocity_rad_s", "reference_velocity_rad_s", "tip_velocity_world_m_s", "torque_commanded_nm"),
    *("read_s", "control_s", "guard_s", "write_s", "observer_s", "log_s", "lateness_s"),
}
_BY_DEVICE = {
    "encoder_status": ("joint_position_rad", "encoder_at_s"),
    "torque_status": ("torque_measured_nm", "torque_at_s"),
    "force_status": ("force_n", "force_at_s"),
}
_OF_A_RUN = ("tip_position_world_m", "press_direction_world")


def checked_ticks(session: Session) -> Samples:
    """The stream "tick", if it can be worked with.

    All columns that something is worked out from are there, of the form that `tick_stream` has, and hold
    finite numbers of a reasonable size wherever their device says that the sample is good; the time always,
    and it runs back only between the runs of two sessions.

    Raises:
        InputError: one of this is not so, or the session has no such stream.
    """
    ticks = session.samples(STREAM_NAME)
    place = f"{session.path}, stream '{STREAM_NAME}'"
    joints = _joint_count(ticks, place)
    for column in tick_stream(joints).columns:
        if column.name in ticks or column.name not in _MAY_LACK:
            _check_form(ticks, column, place)
    _check_values(session, ticks, "time_s", np.ones(len(ticks), dtype=np.bool_))
    _check_order(session, ticks)
    good = {status: ticks[status] == Status.OK for status in _BY_DEVICE}
    for status, names in _BY_DEVICE.items():
        for name in names:
            _check_values(session, ticks, name, good[status])
        _check_clock(session, ticks, names[1], good[status])
    in_run = good["encoder_status"] & (ticks["run"] != NO_RUN) & ~np.isin(ticks["phase"], USELESS)
    for name in _OF_A_RUN:
        _check_values(session, ticks, name, in_run)
    return ticks


def _joint_count(ticks: Samples, place: str) -> int:
    if "joint_position_rad" not in ticks:
        raise SessionError(f"{place}: no column 'joint_position_rad'")
    joints = int(ticks.vector("joint_position_rad").shape[1])
    if joints > _MOST_JOINTS:
        raise SessionError(f"{place}, column 'joint_position_rad': {joints} joints, at most {_MOST_JOINTS}")
    return joints


def _check_form(ticks: Samples, wanted: Column, place: str) -> None:
    if wanted.name not in ticks:
        raise SessionError(f"{place}: no column '{wanted.name}'")
    values = ticks.vector(wanted.name)
    if values.shape[1] != wanted.width:
        raise SessionError(
            f"{place}, column '{wanted.name}': {values.shape[1]} values a tick, expected {wanted.width}"
        )
    if values.dtype.kind != np.dtype(wanted.dtype).kind:
        raise SessionError(f"{place}, column '{wanted.name}': is {values.dtype}, expected {wanted.dtype}")


def _check_clock(session: Session, ticks: Samples, name: str, rows: BoolArray) -> None:
    """Refuse times of samples that are far from their tick's: no clock jumps so, and no motion has it."""
    far = np.flatnonzero(rows & (np.abs(ticks[name] - ticks["time_s"]) > _FAR_S))
    if len(far):
        row = far[0]
        raise InputError(
            f"{session.path}: tick {row + 1}, column '{name}': {ticks[name][row]:g} s is far from the tick's "
            f"own time, {ticks['time_s'][row]:g} s"
        )


def _check_order(session: Session, ticks: Samples) -> None:
    """Refuse ticks in another order than time; where sessions were merged, a clock may begin anew."""
    run, late_s = ticks["run"].astype(np.int64), np.diff(ticks["time_s"])
    to_come = np.minimum.accumulate(np.where(run == NO_RUN, np.iinfo(np.int64).max, run)[::-1])[::-1]
    late = np.flatnonzero((late_s < 0.0) & (np.maximum.accumulate(run)[:-1] >= to_come[1:]))
    if len(late):
        raise InputError(
            f"{session.path}: tick {late[0] + 2}, column 'time_s': is {-late_s[late[0]]:.3g} s before the "
            "tick before it; what wrote this file put its messages into another order"
        )


def _check_values(session: Session, ticks: Samples, name: str, rows: BoolArray) -> None:
    chosen = np.flatnonzero(rows)
    values = ticks.vector(name)[chosen]
    bad = useless_rows(values)
    if len(bad):
        row = values[bad[0]]
        number = float(row[useless_rows(row)[0]])
        raise InputError(
            f"{session.path}: tick {chosen[bad[0]] + 1}, column '{name}': {number:g} is {fault_of(number)}"
            f"{more_like_it(len(bad))}, in a sample that counts as good"
        )
