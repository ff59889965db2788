"""Joint torques and positions over time."""

import numpy as np
import rerun as rr

from palpate.views import colors
from palpate.views.recording.entities import POSITION, TORQUE, send_lines
from palpate.views.scene import Scene


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log one entity a joint: torque measured and commanded, position measured and aimed at."""
    for joint in range(scene.ticks["joint_position_rad"].shape[1]):
        torque = {
            "measured": (scene.ticks["torque_measured_nm"][:, joint], colors.MEASURED),
            "commanded": (scene.ticks["torque_sent_nm"][:, joint], colors.COMMANDED),
        }
        send_lines(recording, f"{TORQUE}/joint_{joint + 1}", scene.time_s, torque, (2.0, 1.0))
        position = {
            "measured": (np.degrees(scene.ticks["joint_position_rad"][:, joint]), colors.MEASURED),
            "aimed at": (np.degrees(scene.ticks["reference_position_rad"][:, joint]), colors.COMMANDED),
        }
        send_lines(recording, f"{POSITION}/joint_{joint + 1}", scene.time_s, position, (2.0, 1.0))
