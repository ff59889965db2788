"""3D scene of a recorded probing session: the arm, the object, and the force on the object."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import tostring

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palpate.control.loop.task import IN_CONTACT, Phase
from palpate.estimation.estimate import Estimate, ParameterEstimate
from palpate.render.recording.file import BACKGROUND, time_column
from palpate.render.recording.rerun_modules import rr, rrb, urdf_reader
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.urdf_text import parse_urdf
from palpate.robot_io.session import Event
from palpate.robot_io.types import FloatArray, IntArray

Columns = Mapping[str, NDArray[Any]]
PICTURES_HZ = 60.0  # rate of 3D poses; the curves keep every tick
VECTORS = (  # with a single joint, a session returns them as scalars
    *("joint_position_rad", "joint_velocity_rad_s", "reference_position_rad", "reference_velocity_rad_s"),
    *("torque_measured_nm", "torque_commanded_nm", "torque_sent_nm"),
)


@dataclass(frozen=True)
class Scene:
    """A probing session as the recording shows it."""

    name: str  # name of the recording
    ticks: Columns  # columns of the "tick" stream, n rows
    urdf: str  # text of the arm's URDF, empty if there is none
    events: tuple[Event, ...] = ()  # events of the session
    estimate: Estimate | None = None  # result of the best offline estimator; None if none was run
    # Coordinate of the surface along the press direction [m], None if nothing was touched.
    surface_m: float | None = None
    # True parameters by name (as in `estimate`) of a simulated session.
    truth: Mapping[str, float] = field(default_factory=dict)
    summary: str = ""  # summary in Markdown

    @property
    def origin_s(self) -> float:
        """The whole second of the session's clock at which the recording's time begins [s].

        It is 0 in simulation. The clock of a real arm may have run for hours.
        """
        return float(np.floor(self.ticks["time_s"][0]))

    @property
    def time_s(self) -> FloatArray:
        """Time of each tick since `origin_s`, shape (n,) [s]."""
        return np.asarray(self.ticks["time_s"] - self.origin_s)

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.ticks["joint_position_rad"].shape[1])

    def estimate_of(self, parameter: str) -> ParameterEstimate | None:
        """Return the offline estimate of a parameter; None if there is none."""
        parameters = self.estimate.parameters if self.estimate is not None else ()
        return next((entry for entry in parameters if entry.name == parameter), None)

    @property
    def press_direction_world(self) -> FloatArray:
        """Unit vector into the object, shape (n, 3)."""
        return np.asarray(self.ticks["press_direction_world"])

    @property
    def depth_m(self) -> FloatArray | None:
        """Displacement into the object, shape (n,), negative above it [m]; None if nothing was touched."""
        if self.surface_m is None:
            return None
        tips = self.ticks["tip_position_world_m"]
        return np.asarray(np.einsum("ij,ij->i", tips, self.press_direction_world) - self.surface_m)

    @property
    def main_press_direction_world(self) -> FloatArray:
        """Mean direction into the object, shape (3,); NaN if it was never known."""
        known = np.isfinite(self.press_direction_world).all(axis=1)
        mean: FloatArray = self.press_direction_world[known].sum(axis=0)
        return mean / np.linalg.norm(mean) if known.any() else np.full(3, np.nan)

    @property
    def picture_moment_s(self) -> float:
        """Time within the last phase of held force, or the middle of the session if there is none [s]."""
        holding = np.flatnonzero(self.ticks["phase"] == Phase.HOLD)
        if not len(holding):
            return float(self.time_s[len(self.time_s) // 2])
        last_hold = holding[self.ticks["run"][holding] == self.ticks["run"][holding[-1]]]
        return float(self.time_s[last_hold[len(last_hold) // 2]])


def picture_rows(time_s: FloatArray) -> IntArray:
    """Return the indices of the times that are drawn in 3D: `PICTURES_HZ` per second, and the last.

    Args:
        time_s: shape (n,) [s].
    """
    grid = np.arange(time_s[0], time_s[-1], 1.0 / PICTURES_HZ)
    return np.unique(np.append(np.searchsorted(time_s, grid), len(time_s) - 1))


ROOT_FRAME = "world"  # frame of everything that is no part of the arm
_ARM, _OBJECT, _TIP = "arm", "object", "tip"
_ARROW_M_PER_N, _ARROW_RADIUS_M = 0.012, 0.004
_ARROW_ASIDE_M = 0.05  # offset to the side, because the tool would hide the arrow
_ARROW = (240, 92, 84)
_BLOCK_M, _BLOCK = (0.09, 0.09, 0.025), (226, 168, 124)  # half sizes and color of the object
_GRID = (120, 134, 150, 60)
_EYE_DIRECTION = np.array([0.35, -1.0, 0.42])  # from the side: the arm moves in the x-z plane
_EYE_DISTANCE = 1.5  # as a multiple of the scene's size


def solid_shapes() -> list[rr.AsComponents]:
    """Return view defaults that draw URDF shapes as solids; Rerun's default is wireframes."""
    shapes = (rr.Cylinders3D, rr.Boxes3D, rr.Ellipsoids3D)
    return [shape.from_fields(fill_mode="solid") for shape in shapes]


def log_moving_arm(
    recording: rr.RecordingStream,
    session: str,
    urdf: str,
    time_s: FloatArray,
    position_rad: FloatArray,
    *,
    name: str = "",
    base_world_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> None:
    """Log the links once, and the motion of the joints (n, joints) [rad] at times (n,) [s].

    Args:
        recording: destination.
        session: session that contains the URDF, for error messages.
        urdf: text of the arm's URDF; nothing is logged if it is empty.
        time_s: times, shape (n,) [s].
        position_rad: joint positions, shape (n, joints) [rad].
        name: name that distinguishes the arm from others in the recording; may be empty for one arm.
        base_world_m: position of the base, shape (3,) [m].

    Raises:
        InputError: the text is not a valid URDF.
    """
    if not urdf:
        return
    entity, prefix = (f"{_ARM}_{name}", f"{name}/") if name else (_ARM, "")
    try:
        tree = _load_urdf(urdf, entity, prefix)
    except (RuntimeError, ValueError, UnicodeEncodeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"session '{session}': its URDF cannot be shown ({reason:.200})") from error
    tree.log_urdf_to_recording(recording)
    child = prefix + tree.root_link().name
    root = rr.Transform3D(translation=base_world_m, parent_frame=ROOT_FRAME, child_frame=child)
    recording.log(f"{entity}/root", root, static=True)
    for joint, angles in zip(_moving_joints(tree), position_rad.T, strict=False):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a measured angle may lie slightly beyond its limit
            columns = joint.compute_transform_columns(angles.tolist(), clamp=False)
        recording.send_columns(f"{entity}/motion/{joint.name}", time_column(time_s), columns)


def _load_urdf(text: str, entity: str = _ARM, frame_prefix: str = "") -> urdf_reader.UrdfTree:
    """Read a URDF from its text, because Rerun reads files only."""
    robot = parse_urdf(text)
    for link in robot.iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            if shape.find(".//mesh") is not None:
                link.remove(shape)
    for parent in list(robot.iter()):
        for named in [child for child in parent if child.get("filename") is not None]:
            parent.remove(named)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(tostring(robot, encoding="unicode"), encoding="utf-8")
        return urdf_reader.UrdfTree.from_file_path(
            path, entity_path_prefix=entity, frame_prefix=frame_prefix or None
        )


def _moving_joints(tree: urdf_reader.UrdfTree) -> list[urdf_reader.UrdfJoint]:
    """Return the movable joints, from the base outwards."""
    inward = {joint.child_link: joint for joint in tree.joints()}

    def distance(joint: urdf_reader.UrdfJoint) -> int:
        return 1 + distance(inward[joint.parent_link]) if joint.parent_link in inward else 0

    moving = [joint for joint in tree.joints() if joint.joint_type in {"revolute", "continuous", "prismatic"}]
    return sorted(moving, key=distance)


def log_object(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the contact force as an arrow next to the tip, and the object as a block.

    Args:
        recording: destination.
        scene: the session.
    """
    rows = picture_rows(scene.time_s)
    press, tips = scene.press_direction_world[rows], scene.ticks["tip_position_world_m"][rows]
    known = np.isfinite(np.hstack([tips, press])).all(axis=1)  # unknown while the guard stops the arm
    rows, press, tips = rows[known], press[known], tips[known]
    vectors = -_ARROW_M_PER_N * np.nan_to_num(scene.ticks["force_n"][rows])[:, None] * press
    outwards = tips - np.einsum("ij,ij->i", tips, press)[:, None] * press
    outwards = outwards / np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    recording.log(_TIP, rr.CoordinateFrame(ROOT_FRAME), static=True)
    recording.log(_TIP, rr.Arrows3D.from_fields(radii=_ARROW_RADIUS_M, colors=[_ARROW]), static=True)
    arrows = rr.Arrows3D.columns(origins=tips + _ARROW_ASIDE_M * outwards, vectors=vectors)
    recording.send_columns(_TIP, time_column(scene.time_s[rows]), arrows)
    touching, into = np.isin(scene.ticks["phase"], IN_CONTACT), scene.main_press_direction_world
    if scene.surface_m is None or not touching.any():
        return
    point = np.asarray(scene.ticks["tip_position_world_m"])[touching].mean(axis=0)
    point += (scene.surface_m - point @ into) * into  # on the surface
    turn, _ = Rotation.align_vectors(into[None], np.eye(3)[2:])
    block = rr.Boxes3D(
        half_sizes=[_BLOCK_M],
        centers=[point + _BLOCK_M[2] * into],
        quaternions=[rr.Quaternion(xyzw=turn.as_quat())],
        colors=[_BLOCK],
    )
    recording.log(_OBJECT, rr.CoordinateFrame(ROOT_FRAME), block, static=True)


def view_3d(scene: Scene) -> rrb.Spatial3DView:
    """Make a view of the arm from the side, with base and all tip positions in sight.

    Args:
        scene: the session.
    """
    points = np.vstack([np.zeros(3), scene.ticks["tip_position_world_m"]])
    lower, upper = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    size = max(float(np.linalg.norm(upper - lower)), 0.2)
    target = (lower + upper) / 2 + np.array([0.0, 0.0, 0.2 * size])
    eye = target + _EYE_DISTANCE * size * _EYE_DIRECTION / np.linalg.norm(_EYE_DIRECTION)
    return rrb.Spatial3DView(
        origin="/",
        name="Arm",
        contents=[f"{_ARM}/**", f"{_OBJECT}/**", f"{_TIP}/**"],
        background=rrb.Background(color=BACKGROUND),
        defaults=solid_shapes(),
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.1, color=_GRID),
        spatial_information=rrb.SpatialInformation(target_frame=ROOT_FRAME),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0)),
    )
