"""Draw leader and follower on the leader's timeline: a Rerun recording and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.common.files import atomic_write
from palpate.render import palette
from palpate.render.recording.file import BACKGROUND, TIME, plot, recording_file, send_lines, shown_on
from palpate.render.recording.rerun_modules import rr, rrb
from palpate.render.recording.scene import log_moving_arm, picture_rows, solid_shapes
from palpate.render.recording.session import log_events, log_phases
from palpate.teleop.haptics import GUESS
from palpate.teleop.merged_sessions import ForceComparison, MergedSessions
from palpate.teleop.virtual_object import GEOMETRY

_LEADER_BASE_M = (0.0, 0.5, 0.0)  # position beside the follower, for display only
_FORCE, _DEPTH, _PHASE, _LINK, _EVENTS = "force", "depth", "phase", "link", "events"
_TROUBLE = {"disagreement", "refused", "link", "link_silent", "trip", "no_estimate"}
_MILLI = 1e3


def record_both(merged: MergedSessions, path: Path) -> float:
    """Write the recording, completely or not at all.

    Args:
        merged: both sessions.
        path: path of the .rrd file.

    Returns:
        Time to use for a screenshot [s].

    Raises:
        InputError: the file cannot be written, the sessions contain no arm, or no message was received.
    """
    haptic, ticks = merged.haptic, merged.ticks
    start_s = float(haptic["time_s"][0])
    hand_s, arm_s = haptic["time_s"] - start_s, merged.to_leader(ticks["time_s"]) - start_s
    named = dict.fromkeys(name for _, data in merged.rendered_models() for name in data["parameters"])
    parameters = [name for name in named if name not in GEOMETRY]
    with recording_file(merged.leader.path.stem, path, _blueprint(parameters)) as recording:
        for name, session, samples, time_s, base_m in (
            ("leader", merged.leader, haptic, hand_s, _LEADER_BASE_M),
            ("follower", merged.follower, ticks, arm_s, (0.0, 0.0, 0.0)),
        ):
            rows = picture_rows(time_s)
            position_rad = samples.vector("joint_position_rad")[rows]
            urdf = session.metadata.urdf
            log_moving_arm(recording, name, urdf, time_s[rows], position_rad, name=name, base_world_m=base_m)
            events, levels = session.events, dict.fromkeys(_TROUBLE, rr.TextLogLevel.WARN)
            times_s = np.array([event.time_s for event in events])
            times_s = (times_s if name == "leader" else merged.to_leader(times_s)) - start_s
            log_events(recording, f"{_EVENTS}/{name}", events, times_s, levels, f"{name}, ")
        for place, time_s, name, values, color in (
            (f"{_FORCE}/leader", hand_s, "felt", haptic["force_n"], palette.MODEL),
            (f"{_FORCE}/follower", arm_s, "measured", ticks["force_n"], palette.MEASURED),
            (_DEPTH, hand_s, "below the virtual surface", _MILLI * haptic["depth_m"], palette.MODEL),
        ):
            send_lines(recording, place, time_s, {name: (values, color, 1.5)})
        log_phases(recording, _PHASE, ticks["phase"], arm_s)
        band = (palette.BAND, 1.0)
        looks = {"felt": (palette.MODEL, 2.0), "95 % from": band, "95 % to": band}
        for name in parameters:  # constant, with its interval, from estimate to estimate
            models = [(e.time_s, data) for e, data in merged.rendered_models() if name in data["parameters"]]
            times = [*(time_s for time_s, _ in models), haptic["time_s"][-1]]
            edges_s = np.repeat(times, 2)[1:-1] - start_s
            ends = np.repeat([data["parameters"][name] for _, data in models], 2, axis=0).astype(float)
            lines = {word: (column, *looks[word]) for word, column in zip(looks, ends.T, strict=True)}
            send_lines(recording, _entity(name), edges_s, lines)
        link = merged.leader.samples("link")
        lines = {
            "age of the newest report [ms]": (_MILLI * link["age_s"], palette.MEASURED, 1.5),
            "round trip [ms]": (_MILLI * link["round_trip_s"], palette.NOISE, 1.5),
        }
        send_lines(recording, _LINK, link["time_s"] - start_s, lines)
    rendered = np.flatnonzero((haptic["force_n"] > 0.0) & (haptic["revision"] != GUESS))
    return float(hand_s[rendered[len(rendered) // 2]]) if len(rendered) else float(hand_s[-1] / 2)


def _blueprint(parameters: Sequence[str]) -> rrb.Blueprint:
    """Arrange both arms and the events on the left, and the curves, one for each parameter, on the right."""
    arms = rrb.Spatial3DView(
        origin="/",
        name="Follower, and the virtual arm behind it",
        contents=["arm_leader/**", "arm_follower/**"],
        background=rrb.Background(color=BACKGROUND),
        defaults=solid_shapes(),
        spatial_information=rrb.SpatialInformation(target_frame="world"),
        eye_controls=rrb.EyeControls3D(
            position=(0.9, -1.3, 0.8), look_target=(0.25, 0.2, 0.2), eye_up=(0, 0, 1)
        ),
    )
    left = rrb.Vertical(arms, rrb.TextLogView(origin=_EVENTS, name="Events"), row_shares=[3, 2])
    right = rrb.Vertical(
        plot(f"{_FORCE}/leader", "Felt by the operator [N]"),
        plot(f"{_FORCE}/follower", "Measured by the follower [N]"),
        rrb.StateTimelineView(origin=_PHASE, name="Follower's phase"),
        plot(_DEPTH, "Depth of the hand [mm]"),
        *(plot(_entity(name), name) for name in parameters),
        plot(_LINK, "Link [ms]", legend=rrb.Corner2D.LeftTop),
    )
    columns = rrb.Horizontal(left, right, column_shares=[5, 6], name="Teleoperation")
    return shown_on(columns, timeline=TIME)


def _entity(parameter: str) -> str:
    return f"parameter/{parameter.replace('.', '_')}"


def draw(path: Path, merged: MergedSessions, rendered: ForceComparison, modeled: ForceComparison) -> None:
    """Write a PNG with forces over time, felt over real force, and the link.

    Args:
        path: the file, replaced if it exists.
        merged: sessions of leader and follower on the leader's clock.
        rendered: felt force, and the real one under the same motion of the hand.
        modeled: force of the model, and the follower's measurement.

    Raises:
        InputError: the file cannot be written.
    """
    import matplotlib as mpl  # noqa: PLC0415, takes half a second to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    mpl.rcdefaults()  # ignores a matplotlibrc in the current folder
    figure = Figure(figsize=(11, 10), layout="constrained")
    over_time, over_force, line = axes = figure.subplots(3, 1)
    haptic, start_s = merged.haptic, float(merged.haptic["time_s"][0])
    hand_s = haptic["time_s"] - start_s
    over_time.plot(hand_s, haptic["force_n"], color=palette.MODEL, lw=1.2, label="felt")
    real_n = np.full(len(haptic), np.nan)
    real_n[np.searchsorted(haptic["time_s"], rendered.time_s)] = rendered.real_n
    look = {"color": palette.TRUTH, "lw": 1.0, "ls": (0, (4, 2))}
    over_time.plot(hand_s, real_n, label="the real object, pressed by the same hand", **look)
    note = {"xycoords": ("data", "axes fraction"), "fontsize": 7, "rotation": 40, "color": palette.BASE}
    for event, data in merged.rendered_models():
        over_time.axvline(event.time_s - start_s, color=palette.BASE, lw=0.8)
        verdict = f", {data['verdict']}" if data["verdict"] else ""
        over_time.annotate(f"estimate {data['revision']}{verdict}", (event.time_s - start_s, 1.01), **note)
    over_time.set(xlabel="time of the leader [s]", ylabel="force [N]")
    over_time.set_ylim(top=1.2 * over_time.get_ylim()[1])  # room for the legend above the presses
    over_time.legend(loc="upper left", frameon=False, ncols=2)
    for forces, color, title in (
        (rendered, palette.MODEL, "felt compared with real"),
        (modeled, palette.MEASURED, "model compared with the follower's measurement"),
    ):
        dots = {"ms": 2, "color": color, "label": f"{title}: {forces.summary()}"}
        over_force.plot(forces.real_n, forces.rendered_n, ".", **dots)
    most = max(float(forces.real_n.max(initial=1.0)) for forces in (rendered, modeled))
    over_force.plot((0.0, most), (0.0, most), color=palette.BASE, lw=0.8)
    over_force.set(xlabel="real force [N]", ylabel="felt, or modeled [N]")
    over_force.legend(loc="upper left", frameon=False)
    link, exchanges = merged.leader.samples("link"), merged.exchanges
    drift_s = exchanges[:, 1] - merged.offset_s
    for time_s, delay_s, color, title in (
        (link["time_s"], link["age_s"], palette.MEASURED, "age of the newest message"),
        (exchanges[:, 0], drift_s, palette.NOISE, "drift of the follower's clock"),
    ):
        line.plot(time_s - start_s, 1e3 * delay_s, color=color, lw=1.0, label=title)
    line.set(xlabel="time of the leader [s]", ylabel="link [ms]")
    line.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, ncols=2)
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=110, format="png")
