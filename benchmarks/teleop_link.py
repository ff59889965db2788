"""The line of a teleoperation: mutated messages, what our frames cost, how punctual the haptic loop is.

python benchmarks/teleop_link.py fuzz [--number 100000]
python benchmarks/teleop_link.py overhead
python benchmarks/teleop_link.py haptics [--seconds 30]
"""

import argparse
import random
import struct
import tempfile
import threading
import time
import zlib
from collections import Counter
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from benchmarks.cyclictest import lateness
from control.loop.timing import SectionTiming
from control.teleop.peer import Arrival, Peer, PeerLimits
from control.teleop.target_queue import TargetQueue
from palpate.runs.robots import find_robot
from palpate.teleop.demo import script
from palpate.teleop.haptics import HapticJob, Orders, run_haptics
from palpate.teleop.leader import leader_metadata
from palpate.teleop.object_law import force_law
from robot_io.errors import InputError
from robot_io.link import (
    ContactModel,
    FrameError,
    Intent,
    ObjectEstimate,
    Parameter,
    Report,
    Target,
    decode,
    encode,
)
from sim_backend.scenario import Scenario

DOWN = (0.0, 0.0, -1.0)
MODEL = ContactModel("kelvin_voigt", ("stiffness_n_m", "damping_n_s_m"), (500.0, 20.0))
MESSAGES = (
    Intent((Target(0, (0.40, 0.0, 0.05), DOWN), Target(1, (0.42, 0.0, 0.05), DOWN)), (5,), 3, False),
    Report(4, 0, (0.4, 0.0, 0.05), 0.1, DOWN, 9.8, (0, 1), (1, 0), "target 7 refused: out of reach", False),
    ObjectEstimate(
        3,
        0,
        (0.4, 0.0, 0.05),
        DOWN,
        (MODEL,),
        (Parameter("stiffness.k", "N/m", 500.0, 499.0, 501.0),),
        "adequate",
        "nothing is missing",
        0.02,
        0.02,
        3,
        12.5,
    ),
)
_CHECKSUM = struct.Struct("<I")


def fuzz(number: int) -> None:
    """Mutated frames into the code of both sides; half of them with a checksum that fits what was mutated."""
    rng = random.Random(1)
    for signed in (False, True):
        counts: Counter[str] = Counter()
        moved, felt = set(), 0
        for n in range(number // 2):
            message = MESSAGES[n % len(MESSAGES)]
            data = _mutated(encode(77, n, 0.02 * n, 0.0, 0.0, message), rng, signed=signed)
            peer, queue = Peer(PeerLimits()), TargetQueue()
            queue.linked = True
            peer.judge(replace(_FIRST, sender=77, sequence=n - 1, sent_s=0.02 * n - 0.02), 0.02 * n)
            try:
                frame = decode(data)
                arrival = peer.judge(frame, 0.02 * n)
                if arrival is not Arrival.FRESH:
                    counts[str(arrival)] += 1
                    continue
                taken = frame.message
            except FrameError:
                counts["refused as malformed"] += 1
                continue
            if taken == message:
                counts["the mutation changed nothing that is said"] += 1
            elif isinstance(taken, Intent):
                queue.take(taken)
                target = queue.begin()
                counts["another valid intent"] += 1
                if target is not None and target not in MESSAGES[0].targets:
                    moved.add(target)
            elif isinstance(taken, ObjectEstimate):
                try:
                    force_law(taken.model)(0.01, 0.1, 1e-3)
                    felt += 1
                except InputError:
                    counts["an estimate that cannot be felt"] += 1
            else:
                counts["another valid report"] += 1
        what = "checksum mended by the attacker" if signed else "damaged on the way"
        print(f"{number // 2} frames, {what}: no exception; {dict(counts)}")
        print(f"  other targets taken: {len(moved)} (within reach, plan and guard); estimates felt: {felt}")


_FIRST = decode(encode(77, 0, 0.0, 0.0, 0.0, MESSAGES[1]))


def _mutated(data: bytes, rng: random.Random, *, signed: bool) -> bytes:
    body = bytearray(data[_CHECKSUM.size :] if signed else data)
    for _ in range(rng.randint(1, 8)):
        place = rng.randrange(len(body))
        kind = rng.randrange(4)
        if kind == 0:
            body[place] ^= 1 << rng.randrange(8)
        elif kind == 1:
            body[place] = rng.randrange(256)
        elif kind == 2 and len(body) > 2:
            del body[place : place + rng.randint(1, 8)]
        else:
            body[place:place] = rng.randbytes(rng.randint(1, 8))
        if not body:
            break
    return _CHECKSUM.pack(zlib.crc32(body)) + bytes(body) if signed else bytes(body)


def overhead(rounds: int = 2000) -> None:
    """Round trips over zenoh on the loopback: plain bytes of the same length, and our frames both ways."""
    import zenoh  # noqa: PLC0415

    report = MESSAGES[1]
    plain = encode(1, 2, 3.0, 4.0, 5.0, report)
    sessions = []
    for way in ("listen", "connect"):
        config = zenoh.Config()
        for key, value in (
            ("mode", '"peer"'),
            ("scouting/multicast/enabled", "false"),
            ("listen/endpoints", "[]"),
        ):
            config.insert_json5(key, value)
        config.insert_json5(f"{way}/endpoints", '["tcp/127.0.0.1:7591"]')
        sessions.append(zenoh.open(config))
    time.sleep(1.0)
    here, there = sessions
    come_back = threading.Event()
    drop = zenoh.CongestionControl.DROP
    answer = there.declare_publisher("bench/back", congestion_control=drop, express=True)
    ask = here.declare_publisher("bench/out", congestion_control=drop, express=True)
    framed = False

    def reflect(sample: zenoh.Sample) -> None:
        data = sample.payload.to_bytes()
        answer.put(encode(1, 2, 3.0, 4.0, 5.0, decode(data).message) if framed else data)

    def arrived(sample: zenoh.Sample) -> None:
        if framed:
            decode(sample.payload.to_bytes()).message  # noqa: B018
        come_back.set()

    subscribers = [
        there.declare_subscriber("bench/out", reflect),
        here.declare_subscriber("bench/back", arrived),
    ]
    time.sleep(1.0)
    found = {False: [], True: []}
    for _ in range(rounds):
        for framed in (False, True):
            come_back.clear()
            begun = time.perf_counter()
            ask.put(encode(1, 2, 3.0, 4.0, 5.0, report) if framed else plain)
            if come_back.wait(1.0):
                found[framed].append(time.perf_counter() - begun)
    raw, ours = (np.median(found[framed]) * 1e6 for framed in (False, True))
    cpu = time.process_time()
    for _ in range(5000):
        decode(encode(1, 2, 3.0, 4.0, 5.0, report)).message  # noqa: B018
    each = (time.process_time() - cpu) / 5000 * 1e6
    print(
        f"round trip, median of {rounds}: raw zenoh {raw:.0f} us, with frames both ways {ours:.0f} us "
        f"({100 * (ours / raw - 1):+.1f} %); one encode and decode {each:.1f} us; {len(plain)} bytes a report"
    )
    del subscribers
    for session in sessions:
        session.close()


def haptics(seconds: float) -> None:
    """The haptic loop's lateness, and right after it cyclictest's at the same rate."""
    with tempfile.TemporaryDirectory() as folder:
        operator = Path(folder) / "operator.yaml"
        operator.write_text(yaml.safe_dump(script(0.05)))
        scene, robot = Scenario(), find_robot("leader")
        job = HapticJob(
            "leader", str(operator), scene, Path(folder) / "leader.mcap", leader_metadata(robot, scene, "")
        )
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
    reference = lateness(seconds, 1000.0)
    print(f"haptic loop: {_in_words(late)}")
    if isinstance(reference, str):
        print(f"cyclictest: {reference}")
        return
    print(f"cyclictest:  {_in_words(reference)}; ratio of p99.9: {late.p999_s / reference.p999_s:.2f}")


def _in_words(late: SectionTiming) -> str:
    p50, p99, p999, most = (f"{1e6 * s:.0f} us" for s in (late.p50_s, late.p99_s, late.p999_s, late.max_s))
    return f"{late.count} ticks, late p50 {p50}, p99 {p99}, p99.9 {p999}, most {most}"


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("fuzz", "overhead", "haptics"))
    parser.add_argument("--number", type=int, default=100_000)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    if options.what == "fuzz":
        fuzz(options.number)
    elif options.what == "overhead":
        overhead()
    else:
        haptics(options.seconds)


if __name__ == "__main__":
    main()
