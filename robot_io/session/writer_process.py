"""The process that writes a session: takes records from the rings to the disk while a program drives a robot.

It outlives Ctrl-C and the death of the program, empties the rings, and finishes the file.
"""

import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

from palpate.robot_io.files.atomic_write import reserve_name
from palpate.robot_io.session.event import EVENT_STREAM, UNCLOSED, Event, SessionMetadata, encode_event
from palpate.robot_io.session.mcap_file import McapFile
from palpate.robot_io.session.shared_log import FINISHED, READY, SharedLog, WriterJob, lock
from palpate.robot_io.session.stream import TIME_COLUMN, streams_from_json

IDLE_S = 0.01
CHUNK_PERIOD_S = 1.0  # a slow stream's chunk is ended after this time, full or not
BATCH = 512  # records taken at once


def main() -> None:
    """Run the job read from standard input."""
    # The program gets these signals as well; it is the one to end the session.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # Drop the loop's priority and core, which a child process inherits.
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with suppress(AttributeError, OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    job = WriterJob.receive(sys.stdin)
    streams = streams_from_json(job.streams)
    log = SharedLog(job.memory, streams, job.ring_slots)
    os.close(job.memory)
    try:
        path = Path(job.path)
        with reserve_name(path):  # exclusive creation; another program may have been faster
            file = path.open("xb")
        with file:
            lock(file)
            metadata = SessionMetadata.from_strings(job.metadata, job.extra)
            drain = _Drain(log, McapFile(file, streams, metadata))
            log.state = READY
            drain.run(job.parent_pid)
            drain.finish()
            os.fsync(file.fileno())
            is_kept = os.path.exists(path) and os.path.samestat(os.stat(path), os.fstat(file.fileno()))
        if is_kept:
            log.state = FINISHED
        else:
            log.fail("the file was deleted or replaced while it was being written", None)
    except Exception as error:  # any error is reported to the program
        text, number = (error.strerror, error.errno) if isinstance(error, OSError) else (None, None)
        log.fail(text or str(error) or repr(error), number)


class _Drain:
    """Writes the contents of the rings to the file."""

    def __init__(self, log: SharedLog, mcap: McapFile) -> None:
        self._log = log
        self._mcap = mcap
        self._last_time_s = 0.0

    def run(self, parent_pid: int) -> None:
        """Empty the rings repeatedly, until the recording program requests the end or has ended.

        Args:
            parent_pid: process id of the program that fills the rings and started this process.
        """
        chunk_end_s = time.monotonic() + CHUNK_PERIOD_S
        while True:
            # Read before the rings are emptied, so that the file contains all records before the request.
            over = self._log.stop_requested or os.getppid() != parent_pid
            count = sum(self._take(name) for name in self._log.rings)
            self._mcap.flush()
            if over and not count:
                return
            if time.monotonic() > chunk_end_s:
                self._mcap.end_chunk()
                chunk_end_s = time.monotonic() + CHUNK_PERIOD_S
            if not count:
                time.sleep(IDLE_S)

    def _take(self, name: str) -> int:
        sequence, records = self._log.rings[name].pop(BATCH)
        if not len(records):
            return 0
        if name == EVENT_STREAM:
            messages = [bytes(record["message"])[: record["size"]] for record in records]
            self._mcap.write_events(sequence.tolist(), records[TIME_COLUMN].tolist(), messages)
        else:
            self._mcap.write_records(name, sequence, records)
        self._last_time_s = max(self._last_time_s, float(records[TIME_COLUMN][-1]))
        return len(records)

    def finish(self) -> None:
        """Write the end of the file, and an event if the program did not ask for it."""
        offered = {name: ring.offered for name, ring in self._log.rings.items()}
        if not self._log.stop_requested:
            event = Event(self._last_time_s, *UNCLOSED)
            self._mcap.write_events([offered[EVENT_STREAM]], [event.time_s], [encode_event(event)])
            offered[EVENT_STREAM] += 1
        self._mcap.finish(offered)


if __name__ == "__main__":
    main()
