"""A recording file that appears whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from palpate.files import whole_file

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
    # Into memory and only then to the disk: Rerun's own writer waits forever when the disk is full.
    with whole_file(path) as unfinished:
        unfinished.touch()  # before the work, so that a folder that is not there is said at once
        recording = rr.RecordingStream(APPLICATION, recording_id=name)
        memory = recording.memory_recording()
        recording.send_blueprint(blueprint)
        recording.send_recording_name(name)
        try:
            yield recording
        finally:  # also where drawing failed: Rerun would grumble about data that nobody took
            content = memory.drain_as_bytes()
        unfinished.write_bytes(content or b"")
