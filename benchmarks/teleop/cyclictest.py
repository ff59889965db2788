"""How punctual the machine itself is: cyclictest of the package rt-tests, where it is installed."""

import shutil
import subprocess

import numpy as np

from robot_io.types import FloatArray

_LONGEST_US = 20_000


def lateness(seconds: float, rate_hz: float) -> FloatArray | str:
    """Lateness of each tick [s], with SCHED_FIFO 80 at the loop's rate; or in words why there is none."""
    if shutil.which("cyclictest") is None:
        return "not installed (package rt-tests)"
    arguments = ["-q", "-t1", "-p80", "-m", f"-i{1e6 / rate_hz:.0f}", f"-l{seconds * rate_hz:.0f}"]
    done = subprocess.run(
        ["cyclictest", *arguments, f"-h{_LONGEST_US}"], capture_output=True, text=True, check=False
    )
    if done.returncode:
        return f"refused ({' '.join((done.stderr or done.stdout).split())})"
    return _read_histogram(done.stdout)


def _read_histogram(text: str) -> FloatArray:
    rows = [line.split() for line in text.splitlines() if line[:1].isdigit()]
    # Totals look like "# Max Latencies: 02519".
    totals = dict(
        line[2:].split(":", 1) for line in text.splitlines() if line.startswith("# ") and ":" in line
    )
    late_us = [int(row[0]) for row in rows] + [int(totals["Max Latencies"])]
    return 1e-6 * np.repeat(late_us, [int(row[1]) for row in rows] + [int(totals["Histogram Overflows"])])
