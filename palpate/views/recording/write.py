"""Puts a session's layers into one .rrd file."""

from collections.abc import Callable
from pathlib import Path

import rerun as rr

from palpate.views.recording import arm, contact, estimates, joints, notes, timing
from palpate.views.recording.blueprint import blueprint
from palpate.views.recording.file import recording_file
from palpate.views.scene import Scene

Layer = Callable[[rr.RecordingStream, Scene], None]
LAYERS: tuple[Layer, ...] = (arm.log, contact.log, joints.log, estimates.log, notes.log, timing.log)


def write_recording(scene: Scene, path: Path) -> None:
    """Write the recording of a probing session; the file appears whole or not at all.

    Args:
        scene: what to show.
        path: the .rrd file.

    Raises:
        InputError: the file cannot be written.
    """
    with recording_file(scene.name, path, blueprint(scene)) as recording:
        for layer in LAYERS:
            layer(recording, scene)
