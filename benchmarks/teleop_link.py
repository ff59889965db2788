"""The line of a teleoperation: what our link costs, and how punctual the haptic loop is.

    python benchmarks/teleop_link.py overhead
    python benchmarks/teleop_link.py haptics [--seconds 10] [--times 3]
    python benchmarks/teleop_link.py demo [--times 3]

overhead: round trips between two processes, three ways in turn, all answered in zenoh's own callback.
    bytes     raw zenoh: bytes of a report's length go out and come back
    message   raw zenoh with a report as protobuf: made, sent, read there, made, sent, read here
    frame     our link: the same with version, sequence, stamps and checksum, each frame judged by a `Peer`
haptics, demo: lateness of the haptic loop beside cyclictest, alone in turn, and within the demo at once.
"""

import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import yaml
from command_line import arguments

from control.teleop.peer import Peer, PeerLimits
from palpate.runs.robots import find_robot
from palpate.teleop.demo import run_demo, script
from palpate.teleop.haptics import STREAM_NAME, HapticCommands, HapticJob, run_haptics
from palpate.teleop.leader import MESSAGE_PERIOD_S, leader_metadata
from robot_io.link import Heard, Report, decode, encode
from robot_io.link.messages import WireType
from robot_io.session import Session
from robot_io.types import FloatArray
from sim_backend.scenario import Scenario, load_scenario

WAYS = ("bytes", "message", "frame")
PORT, WAIT_S = 7591, 30.0
_WIRE = WireType(Report)
Puts = dict[str, Callable[[bytes], Any]]
REPORT = Report(
    4, 0, (0.4, 0.0, 0.05), 0.1, (0.0, 0.0, -1.0), 9.8, (0, 1), (1, 0), "target 7: out of reach", ended=False
)
RATE_HZ = 1000.0
DEMO_S = 28.0  # of cyclictest beside the demo
_LONGEST_US = 20_000


class ReportEnd:
    """One end: how a report goes out and comes in, each way."""

    def __init__(self, sender: int) -> None:
        self._sender, self._sequence, self._peer = sender, 0, Peer(PeerLimits())
        self._plain = _WIRE.encode(REPORT)

    def out(self, way: str, report: Report) -> bytes:
        """The bytes that are sent."""
        if way == "frame":
            self._sequence += 1
            now_s = time.monotonic()
            return encode(self._sender, self._sequence, now_s, Heard(1, now_s, now_s), report)
        return _WIRE.encode(report) if way == "message" else self._plain

    def taken(self, way: str, data: bytes) -> Report:
        """What is made of bytes that have come."""
        if way == "frame":
            frame = decode(data)
            self._peer.judge(frame, time.monotonic())
            return frame.message
        return _WIRE.decode(data) if way == "message" else REPORT


def overhead(rounds: int, pause_s: float) -> str:
    """Measure round trips with a pause before each, and say it in words."""
    process = get_context("spawn").Process(target=_answer, daemon=True)
    process.start()
    session, ask, come_back, _subscriber = _opened("connect", "out", "back")
    end, durations = ReportEnd(1), {way: [] for way in WAYS}
    try:
        _until_linked(ask, come_back)
        for n in range(rounds):
            for way in WAYS:
                report = replace(REPORT, force_n=0.01 * n)
                time.sleep(pause_s)
                begun = time.perf_counter()
                ask[way](end.out(way, report))
                end.taken(way, come_back.get(timeout=WAIT_S))
                durations[way].append(time.perf_counter() - begun)
    finally:
        process.kill()
        process.join()
        session.close()
    plain, message, frame = (1e6 * float(np.median(durations[way])) for way in WAYS)
    return (
        f"round trip between two processes, median of {rounds}, {1e3 * pause_s:g} ms apart: "
        f"raw zenoh {plain:.0f} us, with a report as protobuf {message:.0f} us, our link {frame:.0f} us\n"
        f"our link costs {100 * (frame / message - 1):+.1f} % over zenoh with the same protobuf message, "
        f"{100 * (frame / plain - 1):+.1f} % over zenoh with bytes that nobody makes or reads"
    )


def codec(repeats: int = 40, number: int = 1000) -> str:
    """What making and reading cost here without zenoh: the best of many repeats."""
    end, costs = ReportEnd(1), []
    for way in WAYS[1:]:
        best = []
        for _ in range(repeats):
            begun = time.perf_counter()
            for _ in range(number):
                end.taken(way, end.out(way, REPORT))
            best.append((time.perf_counter() - begun) / number)
        costs.append(f"{way} {1e6 * min(best):.1f} us")
    return f"made and read once, best of {repeats}: {', '.join(costs)}"


def _opened(
    way: str, out: str, come: str
) -> tuple[Any, dict[str, Callable[[bytes], Any]], SimpleQueue[Any], Any]:
    import zenoh  # noqa: PLC0415

    config, arrived = zenoh.Config(), SimpleQueue[bytes]()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{way}/endpoints", f'["tcp/127.0.0.1:{PORT}"]')
    session = zenoh.open(config)
    put = {
        kind: session.declare_publisher(
            f"bench/{out}/{kind}", congestion_control=zenoh.CongestionControl.DROP, express=True
        ).put
        for kind in WAYS
    }
    end = ReportEnd(2)

    def back(sample: zenoh.Sample) -> None:
        kind = str(sample.key_expr).rpartition("/")[2]
        put[kind](end.out(kind, end.taken(kind, sample.payload.to_bytes())))

    def keep(sample: zenoh.Sample) -> None:
        arrived.put(sample.payload.to_bytes())

    subscriber = session.declare_subscriber(f"bench/{come}/*", back if way == "listen" else keep)
    return session, put, arrived, subscriber


def _answer() -> None:
    _kept = _opened("listen", "back", "out")
    time.sleep(10 * WAIT_S)


def _until_linked(ask: Puts, come_back: SimpleQueue[bytes]) -> None:
    end_s = time.monotonic() + WAIT_S
    while time.monotonic() < end_s:
        ask["bytes"](b"")
        try:
            come_back.get(timeout=0.2)
        except Empty:
            continue
        time.sleep(0.5)
        while not come_back.empty():
            come_back.get()
        return
    raise TimeoutError("the two ends do not hear each other")


def alone(seconds: float) -> tuple[FloatArray, FloatArray | str]:
    """Lateness of each tick [s]: the loop for so long, then cyclictest for as long."""
    with tempfile.TemporaryDirectory() as folder:
        operator = Path(folder) / "operator.yaml"
        operator.write_text(yaml.safe_dump(script(0.05)))
        scene, robot = Scenario(), find_robot("leader")
        session = Path(folder) / "leader.mcap"
        job = HapticJob("leader", str(operator), scene, session, leader_metadata(robot, scene, ""))
        context = get_context("spawn")
        own, loop_end = context.Pipe()
        process = context.Process(target=run_haptics, args=(job, loop_end), daemon=True)
        process.start()
        loop_end.close()
        read, late, begun = 0, None, time.monotonic()
        while late is None:
            if own.poll(0.02):
                telling = own.recv()
                read, late = read + 1, telling.lateness
                if read == 1:
                    begun = time.monotonic()
            own.send(HapticCommands(read, end=time.monotonic() - begun > seconds))
        process.join()
        late_s = Session.open(session).samples(STREAM_NAME)["lateness_s"]
    return late_s, lateness(seconds)


def in_demo() -> tuple[FloatArray, FloatArray | str]:
    """The same of the loop within the demo, and of cyclictest at the same time."""
    references: list[FloatArray | str] = []
    beside = threading.Thread(target=lambda: references.append(lateness(DEMO_S)))
    with tempfile.TemporaryDirectory() as folder:
        beside.start()
        made = run_demo(Path(folder) / "demo", load_scenario("stiff"))
        beside.join()
    return made.merged.haptic["lateness_s"], references[0]


def comparison(ours_s: FloatArray, reference_s: FloatArray | str) -> str:
    """Both, and the ratio of what 99.9 % do not exceed."""
    if isinstance(reference_s, str):
        return f"haptic loop: {_quantiles(ours_s)}\ncyclictest:  {reference_s}"
    ratio = np.percentile(ours_s, 99.9) / np.percentile(reference_s, 99.9)
    both = f"haptic loop: {_quantiles(ours_s)}\ncyclictest:  {_quantiles(reference_s)}"
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


def _quantiles(late_s: FloatArray) -> str:
    p50, p99, p999, most = (f"{1e6 * s:.0f} us" for s in np.percentile(late_s, (50.0, 99.0, 99.9, 100.0)))
    return f"{len(late_s)} ticks, late p50 {p50}, p99 {p99}, p99.9 {p999}, most {most}"


def main() -> None:
    """Run one of the three."""
    parser = arguments(__doc__)
    parser.add_argument("what", choices=("overhead", "haptics", "demo"))
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--times", type=int, default=3)
    options = parser.parse_args()
    if options.what == "overhead":
        print(codec())
        print(overhead(2000, 0.0))
        print(overhead(500, MESSAGE_PERIOD_S))
        return
    pairs = []
    for _ in range(options.times):
        pairs.append(alone(options.seconds) if options.what == "haptics" else in_demo())
        print(comparison(*pairs[-1]), flush=True)
    ours, references = zip(*pairs, strict=True)
    if options.times > 1 and not isinstance(references[0], str):
        print(f"all of these\n{comparison(np.concatenate(ours), np.concatenate(references))}")


if __name__ == "__main__":
    main()
