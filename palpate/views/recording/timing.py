"""How long the loop's sections took, and how late it woke up."""

import rerun as rr

from palpate.views import colors
from palpate.views.recording.entities import TIMING, send_lines
from palpate.views.scene import Scene

MICRO = 1e6
SECTIONS = ("read_s", "control_s", "guard_s", "write_s", "observer_s", "log_s")


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the sections as one entity and the lateness as another."""
    present = [name for name in SECTIONS if name in scene.ticks]
    curves = {
        name.removesuffix("_s"): (MICRO * scene.ticks[name], color)
        for name, color in zip(present, colors.SECTIONS, strict=False)
    }
    send_lines(recording, f"{TIMING}/sections", scene.time_s, curves, [1.0] * len(curves))
    if "lateness_s" in scene.ticks:
        late = {"lateness": (MICRO * scene.ticks["lateness_s"], colors.DESIRED)}
        send_lines(recording, f"{TIMING}/lateness", scene.time_s, late, (1.0,))
