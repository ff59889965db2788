"""Joint torques, positions and tracking errors over time."""

from itertools import cycle

import numpy as np
import rerun as rr

from palpate.views import colors
from palpate.views.recording.entities import POSITION, TORQUE, TRACKING, send_lines
from palpate.views.scene import Scene


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log one entity a joint for torque and one for position, each with what was wanted; and all errors."""
    errors_deg = np.degrees(scene.ticks["joint_position_rad"] - scene.ticks["reference_position_rad"])
    shades = cycle(colors.SECTIONS)
    tracking = {f"joint {n}": (error, next(shades)) for n, error in enumerate(errors_deg.T, 1)}
    send_lines(recording, TRACKING, scene.time_s, tracking, [1.5] * len(tracking))
    for joint in range(errors_deg.shape[1]):
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
