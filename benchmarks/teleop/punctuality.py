"""How punctual the haptic loop is, beside cyclictest: alone in turn, and within the demo at once."""

import tempfile
import threading
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from benchmarks.teleop.cyclictest import lateness
from control.loop.timing import Histogram, SectionTiming
from palpate.runs.robots import find_robot
from palpate.teleop.demo import run_demo, script
from palpate.teleop.haptics import HapticJob, Orders, run_haptics
from palpate.teleop.leader import leader_metadata
from sim_backend.scenario import Scenario, load_scenario

RATE_HZ = 1000.0
DEMO_S = 28.0  # of cyclictest beside the demo


def alone(seconds: float) -> tuple[SectionTiming, SectionTiming | str]:
    """The loop for so long, then cyclictest for as long."""
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
    return late, lateness(seconds, RATE_HZ)


def in_demo() -> tuple[SectionTiming, SectionTiming | str]:
    """The loop within the demo, and cyclictest at the same time."""
    found: list[SectionTiming | str] = []
    beside = threading.Thread(target=lambda: found.append(lateness(DEMO_S, RATE_HZ)))
    with tempfile.TemporaryDirectory() as folder:
        beside.start()
        made = run_demo(Path(folder) / "demo", load_scenario("stiff"))
        histogram = Histogram()
        histogram.add(np.maximum(made.joined.haptic["lateness_s"], 0.0))
        beside.join()
    return histogram.summary(), found[0]


def in_words(ours: SectionTiming, reference: SectionTiming | str) -> str:
    """Both, and the ratio of what 99.9 % do not exceed."""
    if isinstance(reference, str):
        return f"haptic loop: {_in_words(ours)}\ncyclictest:  {reference}"
    ratio = ours.p999_s / reference.p999_s
    return f"haptic loop: {_in_words(ours)}\ncyclictest:  {_in_words(reference)}; ratio of p99.9: {ratio:.2f}"


def _in_words(late: SectionTiming) -> str:
    p50, p99, p999, most = (f"{1e6 * s:.0f} us" for s in (late.p50_s, late.p99_s, late.p999_s, late.max_s))
    return f"{late.count} ticks, late p50 {p50}, p99 {p99}, p99.9 {p999}, most {most}"
