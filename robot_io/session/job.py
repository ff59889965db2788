"""What a program tells the process that writes its session."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import IO

MODULE = "robot_io.session.writer_process"


@dataclass(frozen=True)
class Job:
    """One line of JSON on the writer process's standard input.

    Attributes:
        path: the new session file.
        memory: file descriptor of the memory for `SharedLog`.
        streams: the streams as JSON text.
        ring_slots: records that each ring holds.
        parent_pid: process whose end also ends the session.
        metadata: the session's metadata.
        extra: the metadata's extra part.
    """

    path: str
    memory: int
    streams: str
    ring_slots: int
    parent_pid: int
    metadata: dict[str, str]
    extra: dict[str, str]

    def start(self) -> subprocess.Popen[str]:
        """Start the writer process: a fresh interpreter, out of reach of the terminal's Ctrl-C."""
        search_path = os.pathsep.join(filter(None, sys.path))
        process = subprocess.Popen(  # noqa: S603 - nothing in it comes from outside
            [sys.executable, "-P", "-m", MODULE],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=[self.memory],
            env=os.environ | {"PYTHONPATH": search_path, "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,
            text=True,
        )
        if process.stdin:
            with suppress(BrokenPipeError), process.stdin as pipe:  # a process that died is seen by its exit
                pipe.write(json.dumps(asdict(self)) + "\n")
        return process

    @classmethod
    def receive(cls, pipe: IO[str]) -> "Job":
        """Read the job at the other end."""
        return cls(**json.loads(pipe.readline()))
