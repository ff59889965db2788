"""Run leader and follower in two network namespaces, over a network with delay, jitter and packet loss.

python benchmarks/teleop_network.py [--delay-ms 500] [--jitter-ms 20] [--loss 0.2] [--over udp|tcp]

The only connection of the namespaces is a relay that delays and drops IP packets, as netem does if the kernel
has it. zenoh, TCP and UDP are real. Needs root and /dev/net/tun.
"""

import ctypes
import fcntl
import heapq
import json
import os
import secrets
import select
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from harness import PALPATE, arguments

from palpate.robot_io.session import Session
from palpate.sim_backend.scenario import load_scenario
from palpate.teleop.demo import script, write_worlds
from palpate.teleop.merged_sessions import MergedSessions, merge_sessions

SIDES = ("follower", "leader")
LIMIT_S = 120.0
NAMES = ("palpate-one", "palpate-two")
ADDRESSES = ("10.99.0.1", "10.99.0.2")
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000  # Linux, linux/if_tun.h
_CLONE_NEWNET = 0x40000000  # Linux, sched.h
_DEVICE, _MOST_BYTES = "link0", 65536


class LinkFaults(NamedTuple):
    """Faults of the relay, in each direction."""

    delay_s: float
    jitter_s: float  # largest additional delay, uniformly distributed; packets may overtake each other
    loss: float  # share of packets that are lost, independently


@contextmanager
def namespaces(faults: LinkFaults) -> Iterator[None]:
    """Keep both namespaces, with the relay between them, while the context is open.

    Raises:
        OSError, subprocess.CalledProcessError: this machine does not permit it.
    """
    context = get_context("fork")
    ready, relay = context.Event(), None
    try:
        for name in NAMES:
            _ip("netns", "add", name)
        relay = context.Process(target=_relay, args=(faults, ready), daemon=True)
        relay.start()
        if not ready.wait(10.0):
            raise OSError("the relay has not begun")
        for name, own, peer in zip(NAMES, ADDRESSES, ADDRESSES[::-1], strict=True):
            _ip("-n", name, "addr", "add", own, "peer", peer, "dev", _DEVICE)
            for device in ("lo", _DEVICE):
                _ip("-n", name, "link", "set", device, "up")
        yield
    finally:
        if relay is not None:
            relay.kill()
            relay.join()
        for name in NAMES:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


def _device(name: str) -> int:
    """Create a tun device in a namespace, to which the calling process moves."""
    with Path("/run/netns", name).open("rb") as namespace:
        if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"no way into the namespace {name}")
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", _DEVICE.encode(), _IFF_TUN | _IFF_NO_PI))
    return device


def _relay(faults: LinkFaults, ready) -> None:  # noqa: ANN001
    devices = [_device(name) for name in NAMES]
    ready.set()
    rng, numbers = np.random.default_rng(0), count()
    under_way: list[tuple[float, int, int, bytes]] = []  # time of arrival, number, device and packet
    while True:
        wait_s = under_way[0][0] - time.monotonic() if under_way else 1.0
        come, _, _ = select.select(devices, [], [], min(1.0, max(0.0, wait_s)))
        for device in come:
            packet, opposite = os.read(device, _MOST_BYTES), devices[1 - devices.index(device)]
            late, lost = rng.random(2)
            if lost >= faults.loss:
                arrives_s = time.monotonic() + faults.delay_s + late * faults.jitter_s
                heapq.heappush(under_way, (arrives_s, next(numbers), opposite, packet))
        while under_way and under_way[0][0] <= time.monotonic():
            _, _, device, packet = heapq.heappop(under_way)
            with suppress(OSError):  # the other side has not started yet
                os.write(device, packet)


def main() -> None:
    """Run both sides, and print the felt force."""
    parser = arguments(__doc__)
    parser.add_argument("--delay-ms", type=float, default=0.0)
    parser.add_argument("--jitter-ms", type=float, default=0.0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--over", choices=("tcp", "udp"), default="udp")
    options = parser.parse_args()
    faults = LinkFaults(1e-3 * options.delay_ms, 1e-3 * options.jitter_ms, options.loss)
    with tempfile.TemporaryDirectory() as folder, namespaces(faults):
        merged = run(Path(folder), options.over)
        link = merged.leader.samples("link")
        rendered = merged.compare_rendered_to_real(load_scenario("stiff"))
        print(f"over {options.over}, each way of every IP packet: {faults}")
        share, count = rendered.settled().share, len(rendered.real_n)
        counts = ", ".join(f"{link[kind][-1]} {kind}" for kind in ("fresh", "late", "reordered", "lost"))
        print(f"felt force: {100 * share:.2g} % rms from the real one, {count} samples")
        linked_s = link["time_s"][~link["silent"]].min(initial=np.inf) - merged.haptic["time_s"][0]
        print(f"the leader heard the follower {linked_s:.0f} s after its start")
        print(f"frames to the leader: {counts}; shortest round trip {1e3 * merged.round_trip_s:.0f} ms")


def run(folder: Path, over: str) -> MergedSessions:
    """Run both sides until they end."""
    operator = folder / "operator.yaml"
    operator.write_text(yaml.safe_dump(script(0.05, last_s=45.0)))
    write_worlds(folder, load_scenario("stiff"))
    commands = {
        "follower": ["--scenario", str(folder / "real.yaml"), "--no-diagnose"],
        "leader": ["--scenario", str(folder / "guess.yaml"), "--operator", str(operator)],
    }
    (key := folder / "key").touch(0o600)  # a follower refuses a key that others can read
    key.write_bytes(secrets.token_bytes(32))
    endpoint, running = {"endpoints": [f"{over}/{ADDRESSES[0]}:7447"]}, []
    for side, name in zip(SIDES, NAMES, strict=True):
        way, reverse = ("listen", "connect") if side == "follower" else ("connect", "listen")
        wait = {"exit_on_failure": False} if way == "connect" else {}
        config = {"mode": "peer", way: endpoint | wait, reverse: {"endpoints": []}}
        config["scouting"] = {"multicast": {"enabled": False}}
        # tries of 3 s, instead of 10 s: over UDP each may fail
        config["transport"] = {"unicast": {"open_timeout": 3000, "accept_timeout": 3000}}
        (path := folder / f"{side}.json5").write_text(json.dumps(config))
        program = ["ip", "netns", "exec", name, *PALPATE, "teleop", side]
        out = ["--key", str(key), "--link", str(path), "-o", str(folder / f"{side}.mcap")]
        running.append(subprocess.Popen([*program, *commands[side], *out]))
    until_s = time.monotonic() + LIMIT_S
    try:
        for process in reversed(running):
            process.wait(until_s - time.monotonic())
    finally:
        for process in running:
            process.kill()
    return merge_sessions(*(Session.open(folder / f"{side}.mcap") for side in SIDES))


if __name__ == "__main__":
    main()
