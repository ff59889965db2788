"""What the import of a long recording takes: time, and memory over that of the arrays it makes.

    python benchmarks/large_import.py [rows]

The recording is a press at 1 kHz, as text. Reading the session again is measured as well.
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.csv

ARRAYS = 7  # of a channel, of 8 bytes a sample: time, motion, effort, run, phase
READ = "import sys; from palpate.estimation.data.channels import session_channels; "
READ += "from palpate.robot_io import Session; "


def recording(path: Path, rows: int) -> None:
    """Write presses at 0.5 Hz on 500 N/m."""
    rng, time_s = np.random.default_rng(0), np.arange(rows) * 1e-3
    depth_m = 0.004 * np.sin(np.pi * time_s) + 1e-6 * rng.standard_normal(rows)
    force_n = np.maximum(500.0 * depth_m, 0.0) + 0.02 * rng.standard_normal(rows)
    columns = {"time_s": time_s, "displacement_m": depth_m.round(9), "force_N": force_n.round(5)}
    pa.csv.write_csv(pa.table(columns), path)


def measured(what: str, command: list[str], rows: int) -> None:
    """Run a program to its end and print what it took."""
    started = time.perf_counter()
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{what} failed")
    wall_s, peak = time.perf_counter() - started, used.ru_maxrss * 1024
    print(
        f"{what}: processor {used.ru_utime + used.ru_stime:.1f} s, {wall_s:.1f} s, "
        f"peak {peak / 2**20:.0f} MiB, {peak / (rows * 8 * ARRAYS):.1f} times the channel's arrays",
        flush=True,
    )


def main() -> None:
    """Measure all."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 5_000_000
    with TemporaryDirectory() as folder:
        data, session = Path(folder) / "press.csv", Path(folder) / "press.mcap"
        recording(data, rows)
        print(f"{rows:,} rows, text of {data.stat().st_size / 2**20:.0f} MiB")
        measured("import", ["-m", "palpate.main", "import", str(data), "-o", str(session)], rows)
        print(f"session of {session.stat().st_size / 2**20:.0f} MiB")
        again = f"{READ}session_channels(Session.open(sys.argv[1]))"
        measured("read again", ["-c", again, str(session)], rows)


if __name__ == "__main__":
    main()
