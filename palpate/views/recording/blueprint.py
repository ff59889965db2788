"""Where everything stands on the screen."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from palpate.views import colors
from palpate.views.recording.entities import (
    ARM,
    DAMPING,
    DEPTH,
    EVENTS,
    FORCE,
    OBJECT,
    PHASE,
    POSITION,
    ROOT_FRAME,
    STIFFNESS,
    SUMMARY,
    TIMELINE,
    TIMING,
    TIP,
    TORQUE,
    TRACKING,
)
from palpate.views.recording.estimates import shown_range
from palpate.views.scene import Scene
from robot_io.types import FloatArray

EYE_DIRECTION = np.array([0.35, -1.0, 0.42])  # from the side: the arm moves in the x-z plane
EYE_DISTANCE = 1.5  # in sizes of the scene
ABOVE, BELOW = 1.0, 1.1  # range of displacement shown, in greatest depths
LEFT_TOP, RIGHT_TOP = rrb.Corner2D.LeftTop, rrb.Corner2D.RightTop
WHOLE_TIME = rrb.TimeAxis(
    view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
)
# Rerun draws a URDF's cylinders and boxes as wire frames unless it is told otherwise.
SOLID = [shape.from_fields(fill_mode="solid") for shape in (rr.Cylinders3D, rr.Boxes3D, rr.Ellipsoids3D)]


def blueprint(scene: Scene) -> rrb.Blueprint:
    """Arm, notes and estimates on the left, curves on the right; further tabs for positions and timing."""
    joints = scene.ticks["joint_position_rad"].shape[1]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Horizontal(_left(scene), _curves(scene), column_shares=[5, 6], name="Probing"),
            rrb.Vertical(
                _plot(TRACKING, "Tracking error: measured less aimed at [°]", legend=LEFT_TOP),
                *(_plot(f"{POSITION}/joint_{j + 1}", f"Joint {j + 1} [°]") for j in range(joints)),
                name="Joints",
            ),
            rrb.Vertical(
                _plot(f"{TIMING}/sections", "Time in each section [µs]", legend=LEFT_TOP),
                _plot(f"{TIMING}/lateness", "Woken up late by [µs]"),
                name="Loop",
            ),
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        collapse_panels=True,
    )


def _left(scene: Scene) -> rrb.Vertical:
    return rrb.Vertical(
        _view_3d(scene),
        rrb.Horizontal(
            _plot(STIFFNESS, "Stiffness [N/m]", shown_range(scene, STIFFNESS), legend=RIGHT_TOP),
            _plot(DAMPING, "Damping [N s/m]", shown_range(scene, DAMPING)),
        ),
        rrb.Tabs(
            rrb.TextDocumentView(origin=SUMMARY, name="Summary"),
            rrb.TextLogView(origin=EVENTS, name="Events"),
        ),
        row_shares=[4.7, 2.6, 2.9],
    )


def _curves(scene: Scene) -> rrb.Vertical:
    joints = scene.ticks["joint_position_rad"].shape[1]
    depth_m = scene.depth_m
    deepest_mm = 1e3 * float(np.nanmax(depth_m)) if depth_m is not None else 0.0
    depth_span = (-ABOVE * deepest_mm, BELOW * deepest_mm) if deepest_mm > 0 else None
    torques = [
        _plot(f"{TORQUE}/joint_{j + 1}", f"Joint {j + 1} torque [N m]", legend=LEFT_TOP if j == 0 else None)
        for j in range(joints)
    ]
    return rrb.Vertical(
        _plot(FORCE, "Contact force [N]", legend=LEFT_TOP),
        rrb.StateTimelineView(origin=PHASE, name="Phase"),
        _plot(DEPTH, "Displacement [mm]", depth_span),
        *torques,
        row_shares=[4, 1.6, 3] + [2.6] * joints,
    )


def _plot(
    origin: str, name: str, span: tuple[float, float] | None = None, legend: rrb.Corner2D | None = None
) -> rrb.TimeSeriesView:
    """A plot over time; without a corner for it there is no legend, which would cover the curves."""
    axis = rrb.ScalarAxis(range=span) if span else None
    shown = rrb.PlotLegend(legend) if legend else rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=WHOLE_TIME, axis_y=axis, plot_legend=shown)


def _view_3d(scene: Scene) -> rrb.Spatial3DView:
    target, size = _center_and_size(scene)
    eye = target + EYE_DISTANCE * size * EYE_DIRECTION / np.linalg.norm(EYE_DIRECTION)
    return rrb.Spatial3DView(
        origin="/",
        name="Arm",
        contents=[f"{ARM}/**", f"{OBJECT}/**", f"{TIP}/**"],
        background=rrb.Background(color=colors.BACKGROUND),
        defaults=SOLID,
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.1, color=colors.GRID),
        spatial_information=rrb.SpatialInformation(target_frame=ROOT_FRAME),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
    )


def _center_and_size(scene: Scene) -> tuple[FloatArray, float]:
    """Middle and extent of the base and all places of the tip [m]."""
    points = np.vstack([np.zeros(3), scene.ticks["tip_position_world_m"]])
    lower, upper = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    size = max(float(np.linalg.norm(upper - lower)), 0.2)
    return (lower + upper) / 2 + np.array([0.0, 0.0, 0.2 * size]), size
