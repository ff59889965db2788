"""The object, the force on it, and how deep the tip is."""

import numpy as np
import rerun as rr

from palpate.views import colors, style
from palpate.views.plots.phase_strip import stretches
from palpate.views.recording.arm import picture_rows
from palpate.views.recording.dimple import Block
from palpate.views.recording.entities import (
    DEPTH,
    FORCE,
    OBJECT,
    PHASE,
    ROOT_FRAME,
    TIP,
    send_lines,
    time_column,
)
from palpate.views.scene import Scene
from robot_io.types import IntArray

ARROW_M_PER_N = 0.012
ARROW_RADIUS_M = 0.004
ARROW_ASIDE_M = 0.05  # beside the tool, which would hide it
MILLI = 1e3


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log force, displacement and phase over time, and the object with the force arrow in 3D."""
    _log_curves(recording, scene)
    _log_phases(recording, scene)
    _log_arrow(recording, scene)
    _log_object(recording, scene)


def _log_curves(recording: rr.RecordingStream, scene: Scene) -> None:
    force = {
        "desired [N]": (scene.ticks["desired_force_n"], colors.DESIRED),
        "measured [N]": (scene.ticks["force_n"], colors.MEASURED),
    }
    send_lines(recording, FORCE, scene.time_s, force, (1.5, 1.5))
    depth_m = scene.depth_m
    if depth_m is not None:
        curve = {"into the object [mm]": (MILLI * depth_m, colors.MEASURED)}
        send_lines(recording, DEPTH, scene.time_s, curve, (1.5,))


def _log_phases(recording: rr.RecordingStream, scene: Scene) -> None:
    phases = scene.ticks["phase"]
    first = np.array([start for start, _ in stretches(phases)])
    names = [style.phase_name(int(phase)) for phase in phases[first]]
    known = list(dict.fromkeys(names))
    shades = [colors.from_hex(style.PHASE_BY_NAME[name]) for name in known]
    recording.log(PHASE, rr.StateConfiguration(values=known, labels=known, colors=shades), static=True)
    recording.send_columns(PHASE, time_column(scene.time_s[first]), rr.StateChange.columns(state=names))


def _log_arrow(recording: rr.RecordingStream, scene: Scene) -> None:
    """The force with which the object pushes back, beside the tip."""
    rows = _rows_with_tip(scene)
    force = np.nan_to_num(scene.ticks["force_n"][rows])
    press = scene.press_direction_world[rows]
    vectors = -ARROW_M_PER_N * force[:, None] * press
    tips = scene.ticks["tip_position_world_m"][rows]
    outwards = tips - np.einsum("ij,ij->i", tips, press)[:, None] * press
    outwards = outwards / np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    origins = tips + ARROW_ASIDE_M * outwards
    recording.log(TIP, rr.CoordinateFrame(ROOT_FRAME), static=True)
    style_of_arrow = rr.Arrows3D.from_fields(radii=ARROW_RADIUS_M, colors=[colors.FORCE_ARROW])
    recording.log(TIP, style_of_arrow, static=True)
    arrows = rr.Arrows3D.columns(origins=origins, vectors=vectors)
    recording.send_columns(TIP, time_column(scene.time_s[rows]), arrows)


def _rows_with_tip(scene: Scene) -> IntArray:
    rows = picture_rows(scene)
    return rows[scene.known_tip[rows]]


def _log_object(recording: rr.RecordingStream, scene: Scene) -> None:
    point, depth_m = scene.touch_point_world_m, scene.depth_m
    if point is None or depth_m is None:
        return
    block = Block(point, scene.main_press_direction_world)
    for entity, mesh in (("sides", block.sides()), ("top", block.top())):
        recording.log(f"{OBJECT}/{entity}", rr.CoordinateFrame(ROOT_FRAME), mesh, static=True)
    rows = block.rows_that_differ(_rows_with_tip(scene), depth_m)
    tips = scene.ticks["tip_position_world_m"][rows]
    vertices, normals = block.pressed(tips, depth_m[rows])
    columns = rr.Mesh3D.columns(
        vertex_positions=vertices.reshape(-1, 3), vertex_normals=normals.reshape(-1, 3)
    ).partition([vertices.shape[1]] * len(rows))
    recording.send_columns(f"{OBJECT}/top", time_column(scene.time_s[rows]), columns)
