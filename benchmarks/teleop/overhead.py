"""What our link costs over zenoh: round trips between two processes, three ways in turn.

bytes     raw zenoh: bytes of a report's length go out and come back
message   raw zenoh with a report as protobuf: made, sent, read there, made, sent, read here
frame     our link: the same with version, sequence, stamps and checksum, each frame judged by a `Peer`

All three are answered in zenoh's own callback and waited for in the same way.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from benchmarks.teleop.samples import REPORT
from control.teleop.peer import Peer, PeerLimits
from robot_io.link import Heard, Report, decode, encode
from robot_io.link.wire import WireType

WAYS = ("bytes", "message", "frame")
PORT, WAIT_S = 7591, 30.0
_WIRE = WireType(Report)
Puts = dict[str, Callable[[bytes], Any]]


class End:
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
    end, found = End(1), {way: [] for way in WAYS}
    try:
        _until_linked(ask, come_back)
        for n in range(rounds):
            for way in WAYS:
                report = replace(REPORT, force_n=0.01 * n)
                time.sleep(pause_s)
                begun = time.perf_counter()
                ask[way](end.out(way, report))
                end.taken(way, come_back.get(timeout=WAIT_S))
                found[way].append(time.perf_counter() - begun)
    finally:
        process.kill()
        process.join()
        session.close()
    plain, message, frame = (1e6 * float(np.median(found[way])) for way in WAYS)
    return (
        f"round trip between two processes, median of {rounds}, {1e3 * pause_s:g} ms apart: "
        f"raw zenoh {plain:.0f} us, with a report as protobuf {message:.0f} us, our link {frame:.0f} us\n"
        f"our link costs {100 * (frame / message - 1):+.1f} % over zenoh with the same protobuf message, "
        f"{100 * (frame / plain - 1):+.1f} % over zenoh with bytes that nobody makes or reads"
    )


def codec(repeats: int = 40, number: int = 1000) -> str:
    """What making and reading cost here without zenoh: the best of many repeats."""
    end, costs = End(1), []
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
        one: session.declare_publisher(
            f"bench/{out}/{one}", congestion_control=zenoh.CongestionControl.DROP, express=True
        ).put
        for one in WAYS
    }
    end = End(2)

    def back(sample: zenoh.Sample) -> None:
        one = str(sample.key_expr).rpartition("/")[2]
        put[one](end.out(one, end.taken(one, sample.payload.to_bytes())))

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
