"""Puts a session's layers into one .rrd file."""

import os
from collections.abc import Callable
from pathlib import Path

import rerun as rr

from palpate.views.recording import arm, blueprint, contact, estimates, joints, notes, timing
from palpate.views.scene import Scene
from robot_io.errors import InputError

APPLICATION = "palpate"

Layer = Callable[[rr.RecordingStream, Scene], None]
LAYERS: tuple[Layer, ...] = (arm.log, contact.log, joints.log, estimates.log, notes.log, timing.log)


def write_recording(scene: Scene, path: Path) -> None:
    """Write the recording; the file appears whole or not at all.

    Args:
        scene: what to show.
        path: the .rrd file.

    Raises:
        InputError: the file cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        # Rerun reports a file that it cannot open only in its log.
        unfinished.touch()
        recording = rr.RecordingStream(APPLICATION, recording_id=scene.name)
        recording.save(unfinished, default_blueprint=blueprint.blueprint(scene))
        recording.send_recording_name(scene.name)
        for layer in LAYERS:
            layer(recording, scene)
        recording.flush()
        recording.disconnect()
        unfinished.replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
    finally:
        unfinished.unlink(missing_ok=True)
