"""The session log's figures: an append, with a disk that works and one that stands still, and reading.

Run: python benchmarks/session.py [seconds]
"""

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from palpate.robot_io import Column, Session, SessionMetadata, SessionWriter, Stream, write_session

RATE_HZ = 1000
TICK = Stream(
    "tick",
    (
        Column("tick", "1", 1, "", "int64"),
        Column("time_s", "s"),
        *(Column(f"vector_{i}", "rad", 3) for i in range(11)),
        *(Column(f"value_{i}", "N") for i in range(20)),
        *(Column(f"status_{i}", "1", 1, "", "int32") for i in range(6)),
        Column("tripped", "1", 1, "", "bool"),
    ),
)


def append_times_us(log: SessionWriter, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Duration of each append [us] in a loop at `RATE_HZ`."""
    count = int(seconds * RATE_HZ)
    vectors, durations, start_s = rng.normal(size=(count, 11, 3)), np.zeros(count), time.perf_counter()
    for i in range(count):
        record = (i, i / RATE_HZ, *vectors[i], *(0.5,) * 20, *(1,) * 6, False)
        before_ns = time.perf_counter_ns()
        log.append("tick", record)
        durations[i] = (time.perf_counter_ns() - before_ns) / 1e3
        time.sleep(max(0.0, start_s + i / RATE_HZ - time.perf_counter()))
    return durations


def quantiles(durations_us: np.ndarray) -> str:
    """The usual quantiles as text."""
    return " / ".join(f"{value:.1f}" for value in np.percentile(durations_us, [50, 99, 99.9, 100]))


def writing(folder: Path, seconds: float, rng: np.random.Generator) -> None:
    """Append at 1 kHz to a writer at work, to one that stands still, and kill one."""
    log = SessionWriter(folder / "live.mcap", [TICK], SessionMetadata())
    print(f"append, us p50/p99/p99.9/max: {quantiles(append_times_us(log, seconds, rng))}")
    os.kill(log._process.pid, signal.SIGKILL)
    read_back = len(Session.open(folder / "live.mcap").samples("tick"))
    print(f"kill -9 of the writer, read back: {100 * read_back / int(seconds * RATE_HZ):.2f} %")

    log = SessionWriter(folder / "stopped.mcap", [TICK], SessionMetadata(), ring_slots=100)
    os.kill(log._process.pid, signal.SIGSTOP)
    print(
        f"append, writer stopped, us: {quantiles(append_times_us(log, seconds, rng))}, dropped {log.dropped}"
    )
    os.kill(log._process.pid, signal.SIGCONT)
    log.close()
    print(f"dropped, as the file says: {Session.open(folder / 'stopped.mcap').dropped}")


def reading(folder: Path, rng: np.random.Generator) -> None:
    """Write 60 s at once and read them, the first time with the file out of the system's cache."""
    count, path = 60 * RATE_HZ, folder / "whole.mcap"
    columns = {c.name: (100 * rng.normal(size=(count, *c.shape))).astype(c.dtype) for c in TICK.columns}
    start_s = time.perf_counter()
    write_session(path, [(TICK, columns)], SessionMetadata())
    print(f"write 60 s: {time.perf_counter() - start_s:.3f} s, {path.stat().st_size / 1e6:.1f} MB")
    with path.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    for word in ("first", "second"):
        start_s = time.perf_counter()
        Session.open(path).samples("tick")
        print(f"open 60 s, {word} time: {time.perf_counter() - start_s:.3f} s")


def main() -> None:
    """Print all figures."""
    seconds, rng = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0, np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        writing(Path(folder), seconds, rng)
        reading(Path(folder), rng)


if __name__ == "__main__":
    main()
