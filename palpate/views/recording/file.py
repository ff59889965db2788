"""A recording file that appears whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from robot_io.errors import InputError

APPLICATION = "palpate"


@contextmanager
def recording_file(name: str, path: Path, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Open a new .rrd file for writing.

    Args:
        name: of the recording.
        path: the file; replaced if it is there.
        blueprint: how it is shown.

    Raises:
        InputError: the file cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        unfinished.touch()  # Rerun reports a file that it cannot open only in its log
        recording = rr.RecordingStream(APPLICATION, recording_id=name)
        recording.save(unfinished, default_blueprint=blueprint)
        recording.send_recording_name(name)
        yield recording
        recording.flush()
        recording.disconnect()
        unfinished.replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
    except RuntimeError as error:  # what Rerun makes of a full disk
        raise InputError(f"cannot write {path}: {' '.join(str(error).split())}") from error
    finally:
        unfinished.unlink(missing_ok=True)
