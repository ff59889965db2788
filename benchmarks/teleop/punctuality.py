"""How punctual the haptic loop is, beside cyclictest: alone in turn, and within the demo at once."""

import shutil
import subprocess
import tempfile
import threading
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from palpate.runs.robots import find_robot
from palpate.teleop.demo import run_demo, script
from palpate.teleop.haptics import STREAM_NAME, HapticJob, Orders, run_haptics
from palpate.teleop.leader import leader_metadata
from robot_io.session import Session
from robot_io.types import FloatArray
from sim_backend.scenario import Scenario, load_scenario

RATE_HZ = 1000.0
DEMO_S = 28.0  # of cyclictest beside the demo
_LONGEST_US = 20_000


def alone(seconds: float) -> tuple[FloatArray, FloatArray | str]:
    """Lateness of each tick [s]: the loop for so long, then cyclictest for as long."""
    with tempfile.TemporaryDirectory() as folder:
        operator = Path(folder) / "operator.yaml"
        operator.write_text(yaml.safe_dump(script(0.05)))
        scene, robot = Scenario(), find_robot("leader")
        session = Path(folder) / "leader.mcap"
        job = HapticJob("leader", str(operator), scene, session, leader_metadata(robot, scene, ""))
        context = get_context("spawn")
        own, other = context.Pipe()
        process = context.Process(target=run_haptics, args=(job, other), daemon=True)
        process.start()
        other.close()
        read, late, begun = 0, None, time.monotonic()
        while late is None:
            if own.poll(0.02):
                telling = own.recv()
                read, late = read + 1, telling.lateness
                if read == 1:
                    begun = time.monotonic()
            own.send(Orders(read, end=time.monotonic() - begun > seconds))
        process.join()
        late_s = Session.open(session).samples(STREAM_NAME)["lateness_s"]
    return late_s, lateness(seconds)


def in_demo() -> tuple[FloatArray, FloatArray | str]:
    """The same of the loop within the demo, and of cyclictest at the same time."""
    found: list[FloatArray | str] = []
    beside = threading.Thread(target=lambda: found.append(lateness(DEMO_S)))
    with tempfile.TemporaryDirectory() as folder:
        beside.start()
        made = run_demo(Path(folder) / "demo", load_scenario("stiff"))
        beside.join()
    return made.joined.haptic["lateness_s"], found[0]


def in_words(ours_s: FloatArray, reference_s: FloatArray | str) -> str:
    """Both, and the ratio of what 99.9 % do not exceed."""
    if isinstance(reference_s, str):
        return f"haptic loop: {_in_words(ours_s)}\ncyclictest:  {reference_s}"
    ratio = np.percentile(ours_s, 99.9) / np.percentile(reference_s, 99.9)
    both = f"haptic loop: {_in_words(ours_s)}\ncyclictest:  {_in_words(reference_s)}"
    return f"{both}; ratio of p99.9: {ratio:.2f}"


def lateness(seconds: float) -> FloatArray | str:
    """Lateness of each tick of cyclictest (package rt-tests) [s], with SCHED_FIFO 80 at the loop's rate.

    Or in words why there is none.
    """
    if shutil.which("cyclictest") is None:
        return "not installed (package rt-tests)"
    arguments = ["-q", "-t1", "-p80", "-m", f"-i{1e6 / RATE_HZ:.0f}", f"-l{seconds * RATE_HZ:.0f}"]
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


def _in_words(late_s: FloatArray) -> str:
    p50, p99, p999, most = (f"{1e6 * s:.0f} us" for s in np.percentile(late_s, (50.0, 99.0, 99.9, 100.0)))
    return f"{len(late_s)} ticks, late p50 {p50}, p99 {p99}, p99.9 {p999}, most {most}"
