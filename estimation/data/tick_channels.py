"""Create channels from the checked tick records of a probing session."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.control.loop.task import NO_RUN, Phase
from palpate.control.loop.tick_record import STREAM_NAME, tick_stream
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.contact import Contact, find_contacts, find_surface, tare_of
from palpate.estimation.data.derivatives import differentiate, grid_step
from palpate.estimation.data.units import describe_fault, invalid_rows
from palpate.estimation.signals.blocks import blocks, number_pieces
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.session import Samples, Session
from palpate.robot_io.types import BoolArray, FloatArray, IntArray, Status

UNUSED_PHASES = (Phase.IDLE, Phase.STOPPED)
_MAX_JOINTS = 100
_FAR_S = 60.0  # time between a tick and a sample in it that exceeds any age limit
OPTIONAL_COLUMNS = {  # columns that no computation uses
    "tick",
    "guard_tripped",
    *("joint_velocity_rad_s", "reference_velocity_rad_s", "tip_velocity_world_m_s", "torque_commanded_nm"),
    *("read_s", "control_s", "guard_s", "write_s", "observer_s", "log_s", "lateness_s"),
}
_COLUMNS_BY_STATUS = {
    "encoder_status": ("joint_position_rad", "encoder_at_s"),
    "torque_status": ("torque_measured_nm", "torque_at_s"),
    "force_status": ("force_n", "force_at_s"),
}
_RUN_COLUMNS = ("tip_position_world_m", "press_direction_world")


def checked_ticks(session: Session) -> Samples:
    """Return the stream "tick" after checking it.

    The stream must have all columns in use, in the form of `tick_stream`; those that no study needs may be
    left out of memory (`Session.read_columns`). The others must contain finite numbers of plausible
    size wherever the device reports a valid sample. The time must always be valid, and may decrease only
    between the runs of two sessions. The times of a device's valid samples must increase.

    Args:
        session: probing session.

    Raises:
        InputError: a check fails, or the session has no such stream.
    """
    ticks = session.samples(STREAM_NAME)
    place = f"{session.path}, stream '{STREAM_NAME}'"
    columns = {column.name: column for column in ticks.stream.columns}
    if "joint_position_rad" not in columns:
        raise SessionError(f"{place}: no column 'joint_position_rad'")
    joints = columns["joint_position_rad"].width
    if joints > _MAX_JOINTS:
        raise SessionError(f"{place}, column 'joint_position_rad': {joints} joints, at most {_MAX_JOINTS}")
    for column in tick_stream(joints).columns:
        stored = columns.get(column.name)
        if stored is None and column.name in OPTIONAL_COLUMNS:
            continue
        if stored is None:
            raise SessionError(f"{place}: no column '{column.name}'")
        column_place = f"{place}, column '{column.name}'"
        if stored.width != column.width:
            raise SessionError(f"{column_place}: {stored.width} values a tick, expected {column.width}")
        if np.dtype(stored.dtype).kind != np.dtype(column.dtype).kind:
            raise SessionError(f"{column_place}: is {stored.dtype}, expected {column.dtype}")
    _check_values(session, ticks, "time_s", np.ones(len(ticks), dtype=np.bool_))
    # The clock may restart where sessions were merged; otherwise ticks must be in order of time.
    run, late_s = ticks["run"].astype(np.int64), np.diff(ticks["time_s"])
    to_come = np.minimum.accumulate(np.where(run == NO_RUN, np.iinfo(np.int64).max, run)[::-1])[::-1]
    late = np.flatnonzero((late_s < 0.0) & (np.maximum.accumulate(run)[:-1] >= to_come[1:]))
    if len(late):
        raise InputError(
            f"{session.path}: tick {late[0] + 2}, column 'time_s': is {-late_s[late[0]]:.3g} s "
            "earlier than the previous tick; the program that wrote this file reordered its messages"
        )
    clock = np.cumsum(np.append(False, late_s < 0.0))  # of each of the merged sessions
    good = {status: ticks[status] == Status.OK for status in _COLUMNS_BY_STATUS}
    for status, names in _COLUMNS_BY_STATUS.items():
        for name in names:
            _check_values(session, ticks, name, good[status])
        # Sample times must be close to the tick time.
        far = np.flatnonzero(good[status] & (np.abs(ticks[names[1]] - ticks["time_s"]) > _FAR_S))
        if len(far):
            sampled_s, tick_s = (ticks[name][far[0]] for name in (names[1], "time_s"))
            raise InputError(
                f"{session.path}: tick {far[0] + 1}, column '{names[1]}': {sampled_s:g} s is far from the "
                f"tick's own time, {tick_s:g} s"
            )
        _check_increase(session, names[1], ticks[names[1]], clock, np.flatnonzero(good[status]))
    in_run = good["encoder_status"] & (ticks["run"] != NO_RUN) & ~np.isin(ticks["phase"], UNUSED_PHASES)
    for name in _RUN_COLUMNS:
        _check_values(session, ticks, name, in_run)
    return ticks


def _check_increase(
    session: Session, name: str, sampled_at_s: FloatArray, clock: IntArray, good: IntArray
) -> None:
    """Raise an error unless each good sample is newer than the one before it on the same clock."""
    old = np.flatnonzero((np.diff(sampled_at_s[good]) <= 0.0) & (np.diff(clock[good]) == 0))
    if len(old):
        before, after = good[old[0]], good[old[0] + 1]
        raise InputError(
            f"{session.path}: tick {after + 1}, column '{name}': the times of good samples do not increase "
            f"from sample to sample ({sampled_at_s[after]:.9g} s follows {sampled_at_s[before]:.9g} s; "
            f"{len(old)} such samples); the device's clock stood still or went back, or a program changed "
            "the times"
        )


def _check_values(session: Session, ticks: Samples, name: str, rows: BoolArray) -> None:
    chosen = np.flatnonzero(rows)
    values = ticks.vector(name)[chosen]
    bad = invalid_rows(values)
    if len(bad):
        row = values[bad[0]]
        number = float(row[invalid_rows(row)[0]])
        raise InputError(
            f"{session.path}: tick {chosen[bad[0]] + 1}, column '{name}': {number:g} is "
            f"{describe_fault(number, len(bad))}, in a sample marked as good"
        )


DIRECTION = "press_direction_world"
# Columns that the channels need; loading only these saves memory in a long session.
_SHARED_COLUMNS = {"run", "phase", "joint_position_rad", "encoder_at_s", "force_n", "force_at_s", DIRECTION}
_CONTACT_COLUMNS = {*_SHARED_COLUMNS, "tip_position_world_m"}
_JOINT_COLUMNS = {*_SHARED_COLUMNS, "torque_measured_nm", "torque_at_s", "force_status"}
USED_COLUMNS = {*_CONTACT_COLUMNS, *_JOINT_COLUMNS, *_COLUMNS_BY_STATUS, "time_s"}
_SAME_PLACE_M = 0.005  # largest distance across the press direction between contacts at one place
_SAME_DIRECTION = np.cos(np.radians(2.0))
_FREE_LATERAL = 3.0  # ratio to the travel across in free air above which a press may be tilted
_CONTACT_MARGIN_S = 0.05  # time before and after a certain contact in which there may also be contact
_MIN_CONTACT_SAMPLES = 20  # least number of samples in contact for an estimate


def join_ticks(ticks: Sequence[Samples]) -> Samples:
    """Concatenate the ticks of several sessions of one arm; runs are renumbered.

    Times are unchanged. If one clock continues through all sessions, effects with memory persist across them.
    If the clock restarts, as in simulations, each session begins without memory, see `runs_by_time`. Samples
    after the last run of a session are dropped, except in the last session.

    Args:
        ticks: the streams "tick", in order of recording.
    """
    if len(ticks) == 1:
        return ticks[0]
    parts, first = list[dict[str, NDArray[Any]]](), 0
    for number, tick in enumerate(ticks, 1):
        in_run = np.flatnonzero(tick["run"] != NO_RUN)
        end = len(tick) if number == len(ticks) or not len(in_run) else int(in_run[-1]) + 1
        columns = {name: tick[name][:end] for name in tick}
        run = columns["run"]
        columns["run"] = np.where(run == NO_RUN, NO_RUN, run + first).astype(run.dtype)
        first = max(first, int(columns["run"].max(initial=-1)) + 1)
        parts.append(columns)
    shared = [name for name in parts[0] if all(name in part for part in parts)]
    return Samples(ticks[0].stream, {name: np.concatenate([part[name] for part in parts]) for name in shared})


def contact_channels(ticks: Samples, *, tared: bool) -> tuple[ChannelData, ...]:
    """Return the contact force at each probed place as a channel.

    The position is the depth below the surface (see `find_surface`) along the press direction, at the times
    at which the force was sampled. The direction of the first press is taken as the normal of the surface.
    Presses in other directions are excluded: there the tip slides along the surface, so the depth is not the
    travel along the press direction, and the sensor measures only a component of the force.

    Args:
        ticks: the stream "tick".
        tared: whether to subtract each run's force in free air from the force.

    Returns:
        One channel named "contact", or "contact_1", "contact_2" ... in order of probing; empty without
        contact.
    """
    good = _valid_ticks(ticks, "encoder_status", "force_status") & (ticks["run"] != NO_RUN)
    chosen = ticks.select(good, _CONTACT_COLUMNS)
    contacts = find_contacts(chosen["force_n"], chosen["run"], chosen["phase"])
    pressed = [contact for contact in contacts if len(contact.rows) >= _MIN_CONTACT_SAMPLES]
    straight = [contact for contact in pressed if not _is_tilted(contact, chosen, chosen[DIRECTION][0])]
    places: list[tuple[FloatArray, list[Contact]]] = []  # center of each place, and the contacts there
    for contact in straight:
        first = contact.rows[0]
        direction, tip = chosen[DIRECTION][first], chosen["tip_position_world_m"][first]
        center = tip - (tip @ direction) * direction
        near = (touches for middle, touches in places if np.linalg.norm(center - middle) < _SAME_PLACE_M)
        if (touches := next(near, None)) is None:
            places.append((center, [contact]))
        else:
            touches.append(contact)
    names = ["contact"] if len(places) == 1 else [f"contact_{number}" for number in range(1, len(places) + 1)]
    warning = (
        f"{len(pressed) - len(straight)} of {len(pressed)} presses differ in direction from the first press, "
        "whose direction is taken as the surface normal. The forces and joint torques of the presses in "
        "other directions are not used"
    )
    return tuple(
        replace(
            _contact_channel(name, chosen, touches, tared=tared),
            lateral_ratio=min(_lateral_ratio(chosen, contact) for contact in touches),
            import_warnings=(warning,) * (len(straight) < len(pressed)),
        )
        for name, (_, touches) in zip(names, places, strict=True)
    )


def joint_channels(ticks: Samples, known: FloatArray | None = None) -> tuple[ChannelData, ...]:
    """Return the torque of each joint as channels "joint_1", "joint_2" ...

    A move between two runs belongs to the run after it. The context contains the motion of the whole arm as
    `joint_position`, `joint_velocity`, `joint_acceleration` (n, joints) and its torques as `joint_torque` (n,
    joints). It also contains signals of the tip: `contact_force` (n,), positive in compression, minus the
    reading in free air; `touching` (n,), 1 if contact is certain, else 0; and `press_direction_world` (n, 3).

    Presses in other directions than the first press are excluded, with the samples around them. A surface
    reacts along its normal, so the force can have at most one of the two directions.

    Args:
        ticks: ticks of one or several probing sessions.
        known: direction of the first press, shape (3,); None to use that of these ticks.
    """
    useful = ~np.isin(ticks["phase"], UNUSED_PHASES)
    chosen = ticks.select(_valid_ticks(ticks, "encoder_status", "torque_status") & useful, _JOINT_COLUMNS)
    if len(chosen) == 0:
        return ()
    time_s, in_run = chosen["torque_at_s"], chosen["run"] != NO_RUN
    run = np.zeros(len(chosen), dtype=np.int64)
    if in_run.any():
        numbered = np.flatnonzero(in_run)
        following = np.minimum(np.searchsorted(numbered, np.arange(len(run))), len(numbered) - 1)
        run = chosen["run"].astype(np.int64)[numbered[following]]
    # Moves in free air are smooth and allow wide windows, which would bias the acceleration of a press. If
    # moves dominate, windows are therefore compared only on the samples of runs.
    window_rows = np.asarray(in_run) if in_run.any() and np.mean(in_run) < 0.5 else None
    joints = chosen.vector("joint_position_rad").T
    motions = np.empty((len(joints), 3, len(chosen)))  # channels and context share this memory
    for number, joint in enumerate(joints):
        motions[number] = _motion_at(
            time_s, chosen["encoder_at_s"], joint, run, prefer_wide=False, window_rows=window_rows
        )
    motions.setflags(write=False)
    good = _valid_ticks(chosen, "force_status")  # without valid samples, the force is zero
    force_n = _interpolate_per_clock(time_s, chosen["force_at_s"], chosen["force_n"], good)
    torque = chosen.vector("torque_measured_nm")
    contacts = list(find_contacts(force_n, run, chosen["phase"]))
    touching = np.zeros(len(chosen))
    for contact in contacts:
        touching[contact.rows] = 1.0
    position, velocity, acceleration = motions.transpose(1, 2, 0)
    context = {
        "joint_position": position,
        "joint_velocity": velocity,
        "joint_acceleration": acceleration,
        "joint_torque": torque,
        "contact_force": force_n - tare_of(contacts).of(run),  # the sensor's bias does not act on the joints
        "touching": touching,
        DIRECTION: chosen[DIRECTION],
    }
    directions, valid = chosen[DIRECTION], np.ones(len(chosen), dtype=np.bool_)
    first = directions[0] if known is None else known
    for contact in contacts:
        if len(contact.rows) and _is_tilted(contact, chosen, first):
            begun_s, ended_s = time_s[contact.rows[[0, -1]]]
            near = (time_s > begun_s - _CONTACT_MARGIN_S) & (time_s < ended_s + _CONTACT_MARGIN_S)
            valid &= ~(near & (chosen["run"] == contact.run))
    phase, names = chosen["phase"].astype(np.int64), [f"joint_{n}" for n in range(1, len(motions) + 1)]
    channels = (
        ChannelData(name, ChannelKind.REVOLUTE, time_s, x, v, a, effort, run, phase, context)
        for name, (x, v, a), effort in zip(names, motions, torque.T, strict=True)
    )
    return tuple(channel if valid.all() else channel.select(valid) for channel in channels)


def _is_tilted(contact: Contact, ticks: Samples, normal: FloatArray) -> bool:
    """Return whether a press with samples in contact had another direction than the surface's normal."""
    return bool(ticks[DIRECTION][contact.rows[0]] @ normal < _SAME_DIRECTION)


def _lateral_ratio(ticks: Samples, contact: Contact) -> float:
    """Return the travel across the press direction relative to the depth; 0 if similar in free air."""
    first, length = contact.rows[0], len(contact.rows)
    direction = ticks[DIRECTION][first]
    before = np.flatnonzero(ticks["run"][:first] == contact.run)[-length:]
    travels_m = []
    for rows in (before, contact.rows):
        tip_m = ticks["tip_position_world_m"][rows] - ticks["tip_position_world_m"][rows[:1]]
        along_m = tip_m @ direction
        across_m = np.linalg.norm(tip_m - along_m[:, None] * direction, axis=1)
        travels_m.append((float(along_m.max(initial=0.0)), float(across_m.max(initial=0.0))))
    (_, in_air_m), (deepest_m, across_m) = travels_m
    return across_m / deepest_m if deepest_m > 0.0 and across_m > _FREE_LATERAL * in_air_m else 0.0


def _valid_ticks(ticks: Samples, *status_columns: str) -> BoolArray:
    """Return the mask of ticks in which all these devices delivered a new and valid sample."""
    return np.asarray(np.all([ticks[name] == Status.OK for name in status_columns], axis=0))


def _motion_at(
    time_s: FloatArray,
    sampled_at_s: FloatArray,
    position: FloatArray,
    run: IntArray,
    rounding: float | None = None,
    *,
    prefer_wide: bool = True,
    window_rows: BoolArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity and acceleration at given times; the derivatives are interpolated.

    Interpolated positions would have correlated errors, which `differentiate` would treat as motion.
    """
    if not sample_time(sampled_at_s, run) > 0.0:
        raise InputError("column 'encoder_at_s': its times do not increase from sample to sample")
    pieces = number_pieces(sampled_at_s, run)
    motion = differentiate(
        sampled_at_s, position, pieces, rounding=rounding, prefer_wide=prefer_wide, window_rows=window_rows
    )
    signals = position, motion.velocity, motion.acceleration
    if np.array_equal(time_s, sampled_at_s):
        return signals
    every = np.ones(len(position), dtype=np.bool_)
    first, second, third = (_interpolate_per_clock(time_s, sampled_at_s, x, every) for x in signals)
    return first, second, third


def _interpolate_per_clock(
    time_s: FloatArray, sampled_at_s: FloatArray, values: FloatArray, good: BoolArray
) -> FloatArray:
    """Interpolate valid values at given times, (n,), separately for each clock of joined sessions."""
    clock = np.concatenate([[0], np.cumsum(np.diff(time_s) < 0.0)])
    runs = np.zeros(len(time_s))
    for rows in blocks(clock):
        known = good[rows]
        if known.any():
            runs[rows] = np.interp(time_s[rows], sampled_at_s[rows][known], values[rows][known])
    return runs


def _contact_channel(name: str, ticks: Samples, contacts: list[Contact], *, tared: bool) -> ChannelData:
    rows = np.isin(ticks["run"], [contact.run for contact in contacts])
    place = np.cumsum(rows) - 1  # of each sample among the chosen ones
    contacts = [replace(each, rows=place[each.rows], free=place[each.free]) for each in contacts]
    chosen = ticks.select(rows)
    time_s, run = chosen["force_at_s"], chosen["run"].astype(np.int64)
    travel_m = np.einsum("ij,ij->i", chosen["tip_position_world_m"], chosen[DIRECTION])
    # Variance of the tip's position due to the steps of the encoders [m^2].
    joint_position_rad = chosen.vector("joint_position_rad")
    steps_rad = np.array([grid_step(joint) for joint in joint_position_rad.T])
    moves_rad = np.diff(joint_position_rad, axis=0)
    lever_m = np.linalg.lstsq(moves_rad, np.diff(travel_m), rcond=None)[0]
    rounding_m2 = float(np.sum((lever_m * steps_rad) ** 2) / 12)
    along_m, speed_m_s, acceleration_m_s2 = _motion_at(
        time_s, chosen["encoder_at_s"], travel_m, run, rounding_m2
    )
    tare = tare_of(contacts)
    above_n = chosen["force_n"] - tare.of(run)
    step_m = float(np.sqrt(12 * rounding_m2))
    surface = find_surface(along_m, speed_m_s, above_n, run, contacts, step_m)
    motion = along_m - surface.position_m, speed_m_s, acceleration_m_s2
    samples = time_s, *motion, above_n if tared else chosen["force_n"], run, chosen["phase"].astype(np.int64)
    return ChannelData(
        name,
        ChannelKind.CONTACT,
        *samples,
        surface=surface,
        tare=tare if tared else None,
        position_step=step_m,
    )
