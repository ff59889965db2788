"""Record a probing session for Rerun: the arm in 3D, and its signals, estimates and events over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np

from palpate.estimation.signals.blocks import block_index
from palpate.render import palette
from palpate.render.palette import phase
from palpate.render.recording.file import (
    TIME,
    Line,
    markdown,
    plot,
    recording_file,
    send_lines,
    shown_on,
    time_column,
)
from palpate.render.recording.rerun_modules import rr, rrb
from palpate.render.recording.scene import Scene, log_moving_arm, log_object, picture_rows, view_3d
from palpate.robot_io.session import Event
from palpate.robot_io.types import FloatArray, IntArray

_TO_MILLI, _TO_MICRO = 1e3, 1e6
_FORCE, _DEPTH, _PHASE = "contact/force", "contact/displacement", "phase"
_TORQUE, _POSITION, _TRACKING, _TIMING = "torque", "position", "tracking", "timing"
_EVENTS, _SUMMARY = "events", "summary"
_PARAMETERS = {  # entity: name offline, column online, title
    "estimate/stiffness": ("stiffness.k", "stiffness_n_m", "Stiffness [N/m]"),
    "estimate/damping": ("damping.c", "damping_n_s_m", "Damping [N s/m]"),
}
_SECTIONS = ("read_s", "control_s", "guard_s", "write_s", "observer_s", "log_s")
_LOWEST, _HIGHEST = 0.7, 1.8  # vertical range, as multiples of an estimate's levels, with room for the legend
_ROOM = 0.7  # share of a torque's range that is left above it for the legend
_ABOVE, _BELOW = 1.0, 1.1  # range of displacement shown, as multiples of the greatest depth
_TROUBLE = ("stop", "failure", "log_failed", "observer_failed", "obstacle", "missed_surface")


def record_session(scene: Scene, path: Path) -> None:
    """Write the recording of a probing session, completely or not at all.

    Args:
        scene: the session.
        path: path of the .rrd file.

    Raises:
        InputError: the file cannot be written, or the session's URDF cannot be shown.
    """
    rows, ticks, time_s = picture_rows(scene.time_s), scene.ticks, scene.time_s
    with recording_file(scene.name, path, _blueprint(scene)) as recording:
        log_moving_arm(recording, scene.name, scene.urdf, time_s[rows], ticks["joint_position_rad"][rows])
        log_object(recording, scene)
        for entity, lines in _curves(scene):
            send_lines(recording, entity, time_s, lines)
        for entity, lines in _levels(scene):
            send_lines(recording, entity, time_s[[0, -1]], lines)
        log_phases(recording, _PHASE, ticks["phase"], time_s)
        if scene.summary:
            recording.log(_SUMMARY, markdown(scene.summary), static=True)
        levels = dict.fromkeys(_TROUBLE, rr.TextLogLevel.WARN) | {"trip": rr.TextLogLevel.ERROR}
        times_s = np.array([event.time_s for event in scene.events]) - scene.origin_s
        log_events(recording, _EVENTS, scene.events, times_s, levels)


def _curves(scene: Scene) -> Iterator[tuple[str, Mapping[str, Line]]]:
    """Yield force, displacement, torques and positions with their commands, timing, and online estimates."""
    ticks = scene.ticks
    yield (
        _FORCE,
        {
            "desired [N]": (ticks["desired_force_n"], palette.TRUTH, 1.5),
            "measured [N]": (ticks["force_n"], palette.MEASURED, 1.5),
        },
    )
    if scene.depth_m is not None:
        yield _DEPTH, {"into the object [mm]": (_TO_MILLI * scene.depth_m, palette.MEASURED, 1.5)}
    position, reference = (np.degrees(ticks[f"{name}_position_rad"]) for name in ("joint", "reference"))
    errors = zip((position - reference).T, cycle(palette.JOINTS), strict=False)
    yield _TRACKING, {f"joint {n}": (error, color, 1.5) for n, (error, color) in enumerate(errors, 1)}
    torque_nm = ticks["torque_measured_nm"].copy()
    torque_nm[0] = np.nan  # the drive was off, and its zeros would stretch the axes
    for joint in range(scene.joints):
        for entity, measured, intended, name in (
            (_TORQUE, torque_nm, ticks["torque_sent_nm"], "sent"),
            (_POSITION, position, reference, "reference"),
        ):
            lines = {"measured": (measured[:, joint], palette.MEASURED, 2.0)}
            yield f"{entity}/joint_{joint + 1}", lines | {name: (intended[:, joint], palette.MODEL, 1.0)}
    # durations of the loop's sections, and lateness of its wake-up
    present = zip((name for name in _SECTIONS if name in ticks), palette.JOINTS, strict=False)
    sections = {name.removesuffix("_s"): (_TO_MICRO * ticks[name], color, 1.0) for name, color in present}
    if sections:
        yield f"{_TIMING}/sections", sections
    if "lateness_s" in ticks:
        yield f"{_TIMING}/lateness", {"lateness": (_TO_MICRO * ticks["lateness_s"], palette.TRUTH, 1.0)}
    for entity, (_, column, _) in _PARAMETERS.items():
        yield f"{entity}/online", {"online": (ticks[column], palette.MEASURED, 4.0)}


def _levels(scene: Scene) -> Iterator[tuple[str, Mapping[str, Line]]]:
    """Yield offline estimates with their intervals, and true values, as values at the first and last tick."""
    for entity, (name, *_) in _PARAMETERS.items():
        if (estimate := scene.estimate_of(name)) is not None:
            low, high = estimate.interval
            lines = {
                "afterwards": (np.full(2, estimate.value), palette.NOISE, 2.0),
                "95 % from": (np.full(2, low), palette.BAND, 1.0),
                "95 % to": (np.full(2, high), palette.BAND, 1.0),
            }
            yield f"{entity}/afterwards", lines
        if name in scene.truth:
            yield f"{entity}/truth", {"truth": (np.full(2, scene.truth[name]), palette.TRUTH, 1.0)}


def log_events(  # noqa: PLR0917, what a log is made of
    recording: rr.RecordingStream,
    entity: str,
    events: Sequence[Event],
    time_s: FloatArray,
    levels: Mapping[str, rr.TextLogLevel],
    lead: str = "",
) -> None:
    """Log events as text.

    Args:
        recording: destination.
        entity: path of the log.
        events: events, n of them.
        time_s: times of the events, shape (n,) [s].
        levels: levels of kinds of events; information for the others.
        lead: text before each event.
    """
    if events:
        columns = rr.TextLog.columns(
            text=[f"{lead}{event.kind}: {event.text}" for event in events],
            level=[levels.get(event.kind, rr.TextLogLevel.INFO) for event in events],
        )
        recording.send_columns(entity, time_column(time_s), columns)


def log_phases(recording: rr.RecordingStream, entity: str, phases: IntArray, time_s: FloatArray) -> None:
    """Log names and colors of phases, from numbers of `Phase` at times (n,) [s].

    Args:
        recording: destination.
        entity: path of the phases.
        phases: numbers of `Phase`, shape (n,).
        time_s: shape (n,) [s].
    """
    first, _ = block_index(phases)
    shown = [phase(int(number)) for number in phases[first]]
    colors = {name: palette.rgb(color) for name, color in shown}
    known = rr.StateConfiguration(values=list(colors), labels=list(colors), colors=list(colors.values()))
    recording.log(entity, known, static=True)
    changes = rr.StateChange.columns(state=[name for name, _ in shown])
    recording.send_columns(entity, time_column(time_s[first]), changes)


def _blueprint(scene: Scene) -> rrb.Blueprint:
    """Arrange arm, notes and estimates on the left, curves on the right, and further tabs."""
    estimates: list[rrb.View] = []
    for entity, (name, column, title) in _PARAMETERS.items():
        # the vertical range covers the final values of an estimate rather than its first ones
        estimate, online = scene.estimate_of(name), scene.ticks[column][np.isfinite(scene.ticks[column])]
        levels = [scene.truth[name]] if name in scene.truth else []
        levels += [estimate.value] if estimate is not None else []
        levels += [float(np.median(online))] if len(online) else []
        span = (_LOWEST * min(levels), _HIGHEST * max(levels)) if levels and min(levels) > 0 else None
        estimates.append(plot(entity, title, span, legend=None if estimates else rrb.Corner2D.RightTop))
    notes = rrb.Tabs(
        rrb.TextDocumentView(origin=_SUMMARY, name="Summary"), rrb.TextLogView(origin=_EVENTS, name="Events")
    )
    left = rrb.Vertical(view_3d(scene), rrb.Horizontal(*estimates), notes, row_shares=[4.7, 2.6, 2.9])
    deepest_mm = _TO_MILLI * float(np.nanmax(scene.depth_m)) if scene.depth_m is not None else 0.0
    depths = (-_ABOVE * deepest_mm, _BELOW * deepest_mm) if deepest_mm > 0 else None
    torque_nm = scene.ticks["torque_measured_nm"][1:, 0]
    low, high = (pick(torque_nm, initial=0.0, where=np.isfinite(torque_nm)) for pick in (np.min, np.max))
    # The range includes zero, so that Rerun labels at least two values. The room above is for the legend.
    first = (low, high + _ROOM * (high - low)) if high > low else None, rrb.Corner2D.LeftTop
    torques = [
        plot(f"{_TORQUE}/joint_{j}", f"Joint {j} torque [N m]", *(first if j == 1 else ()))
        for j in range(1, scene.joints + 1)
    ]
    curves = rrb.Vertical(
        plot(_FORCE, "Contact force [N]", legend=rrb.Corner2D.LeftTop),
        rrb.StateTimelineView(origin=_PHASE, name="Phase"),
        plot(_DEPTH, "Displacement [mm]", depths),
        *torques,
        row_shares=[4, 1.6, 3] + [2.6] * scene.joints,
    )
    joints = [plot(f"{_POSITION}/joint_{j + 1}", f"Joint {j + 1} [°]") for j in range(scene.joints)]
    tracking = plot(_TRACKING, "Tracking error: measured − reference [°]", legend=rrb.Corner2D.LeftTop)
    sections = plot(f"{_TIMING}/sections", "Time in each section [µs]", legend=rrb.Corner2D.LeftTop)
    return shown_on(
        rrb.Horizontal(left, curves, column_shares=[5, 6], name="Probing"),
        rrb.Vertical(tracking, *joints, name="Joints"),
        rrb.Vertical(sections, plot(f"{_TIMING}/lateness", "Wake-up delay [µs]"), name="Loop"),
        timeline=TIME,
    )
