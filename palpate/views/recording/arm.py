"""The arm in 3D, moved by the measured joint positions."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.urdf import UrdfJoint, UrdfTree

from palpate.views.recording.entities import ARM, ROOT_FRAME, time_column
from palpate.views.scene import Scene
from robot_io.errors import InputError
from robot_io.types import IntArray

RATE_HZ = 60.0  # of the pictures; the curves keep every tick


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the links once and the joints' motion; nothing where the session holds no URDF.

    Raises:
        InputError: what it holds is no URDF.
    """
    if not scene.urdf:
        return
    try:
        tree = load_urdf(scene.urdf)
    except (RuntimeError, ValueError, UnicodeEncodeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"session '{scene.name}': its URDF cannot be shown ({reason:.200})") from error
    tree.log_urdf_to_recording(recording)
    root = rr.Transform3D(parent_frame=ROOT_FRAME, child_frame=tree.root_link().name)
    recording.log(f"{ARM}/root", root, static=True)
    rows = picture_rows(scene)
    positions = scene.ticks["joint_position_rad"][rows]
    for number, joint in enumerate(moving_joints(tree)[: positions.shape[1]]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a measured angle may lie a little past its limit
            columns = joint.compute_transform_columns(positions[:, number].tolist(), clamp=False)
        recording.send_columns(f"{ARM}/motion/{joint.name}", time_column(scene.time_s[rows]), columns)


def load_urdf(text: str) -> UrdfTree:
    """Read a URDF from its text; Rerun takes files only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return UrdfTree.from_file_path(path, entity_path_prefix=ARM)


def moving_joints(tree: UrdfTree) -> list[UrdfJoint]:
    """The joints that move, from the base outwards."""
    inward = {joint.child_link: joint for joint in tree.joints()}

    def distance(joint: UrdfJoint) -> int:
        return 1 + distance(inward[joint.parent_link]) if joint.parent_link in inward else 0

    moving = [joint for joint in tree.joints() if joint.joint_type in {"revolute", "continuous", "prismatic"}]
    return sorted(moving, key=distance)


def picture_rows(scene: Scene) -> IntArray:
    """Indices of the ticks that are drawn in 3D, about `RATE_HZ` of them a second, and the last."""
    time_s = scene.time_s
    grid = np.arange(0.0, time_s[-1], 1.0 / RATE_HZ)
    return np.unique(np.append(np.searchsorted(time_s, grid), len(time_s) - 1))
