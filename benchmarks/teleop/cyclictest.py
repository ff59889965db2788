"""How punctual the machine itself is: cyclictest of the package rt-tests, where it is installed."""

import shutil
import subprocess

import numpy as np

from control.loop.timing import SectionTiming

_LONGEST_US = 20_000


def lateness(seconds: float, rate_hz: float) -> SectionTiming | str:
    """Lateness of cyclictest with SCHED_FIFO 80 at the loop's rate; or in words why there is none."""
    if shutil.which("cyclictest") is None:
        return "not installed (package rt-tests)"
    arguments = ["-q", "-t1", "-p80", "-m", f"-i{1e6 / rate_hz:.0f}", f"-l{seconds * rate_hz:.0f}"]
    done = subprocess.run(
        ["cyclictest", *arguments, f"-h{_LONGEST_US}"], capture_output=True, text=True, check=False
    )
    if done.returncode:
        return f"refused ({' '.join((done.stderr or done.stdout).split())})"
    return _read_histogram(done.stdout)


def _read_histogram(text: str) -> SectionTiming:
    rows = [line.split() for line in text.splitlines() if line[:1].isdigit()]
    # Totals look like "# Max Latencies: 02519".
    totals = dict(
        line[2:].split(":", 1) for line in text.splitlines() if line.startswith("# ") and ":" in line
    )
    max_us, overflows = int(totals["Max Latencies"]), int(totals["Histogram Overflows"])
    late_us = np.array([int(row[0]) for row in rows] + [max_us])
    ticks = np.cumsum([int(row[1]) for row in rows] + [overflows])
    p50_s, p99_s, p999_s = (1e-6 * late_us[np.searchsorted(ticks, q * ticks[-1])] for q in (0.5, 0.99, 0.999))
    return SectionTiming(int(ticks[-1]), p50_s, p99_s, p999_s, 1e-6 * max_us)
