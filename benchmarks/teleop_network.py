"""Leader and follower on two machines, as network namespaces, over a network that delays, jitters and loses.

python benchmarks/teleop_network.py [--delay-ms 500] [--jitter-ms 20] [--loss 0.2] [--over udp|tcp]

Real zenoh, real TCP or UDP; what is lost are IP packets. Needs root and /dev/net/tun.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml
from command_line import arguments

from benchmarks.teleop.link import LinkFaults
from benchmarks.teleop.namespaces import ADDRESSES, NAMES, namespaces
from palpate.teleop.demo import script, write_worlds
from palpate.teleop.joined import Joined, join
from robot_io.session import Session
from sim_backend.scenario import load_scenario

SIDES = ("follower", "leader")
LIMIT_S = 120.0


def main() -> None:
    """Run both, and say what was felt."""
    parser = arguments(__doc__)
    parser.add_argument("--delay-ms", type=float, default=0.0)
    parser.add_argument("--jitter-ms", type=float, default=0.0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--over", choices=("tcp", "udp"), default="udp")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    faults = LinkFaults(1e-3 * options.delay_ms, 1e-3 * options.jitter_ms, options.loss)
    with tempfile.TemporaryDirectory() as folder, namespaces(faults, options.seed):
        joined = run(Path(folder), options.over)
        link = joined.leader.samples("link")
        felt = joined.felt_and_real(load_scenario("stiff"))
        print(f"over {options.over}, {faults} (delay + jitter, loss) each way of every IP packet")
        share, count = felt.settled().share, len(felt.real_n)
        counts = ", ".join(f"{link[kind][-1]} {kind}" for kind in ("fresh", "late", "reordered", "lost"))
        print(f"felt force: {100 * share:.2g} % rms from the real one, {count} samples")
        linked_s = link["time_s"][~link["silent"]].min(initial=np.inf) - joined.haptic["time_s"][0]
        print(f"the leader heard the follower {linked_s:.0f} s after its start")
        print(f"frames to the leader: {counts}; shortest round trip {1e3 * joined.round_trip_s:.0f} ms")


def run(folder: Path, over: str) -> Joined:
    """Both sides until they end."""
    operator = folder / "operator.yaml"
    operator.write_text(yaml.safe_dump(script(0.05, last_s=45.0)))
    write_worlds(folder, load_scenario("stiff"))
    commands = {
        "follower": ["--scenario", str(folder / "real.yaml"), "--no-diagnose"],
        "leader": ["--scenario", str(folder / "guess.yaml"), "--operator", str(operator)],
    }
    endpoint, running = {"endpoints": [f"{over}/{ADDRESSES[0]}:7447"]}, []
    for side, name in zip(SIDES, NAMES, strict=True):
        way, other = ("listen", "connect") if side == "follower" else ("connect", "listen")
        wait = {"exit_on_failure": False} if way == "connect" else {}
        multicast = {"multicast": {"enabled": False}}
        tries = {"unicast": {"open_timeout": 3000, "accept_timeout": 3000}}  # of 10 s: over UDP each may fail
        ends = {way: endpoint | wait, other: {"endpoints": []}}
        config = {"mode": "peer", "scouting": multicast, "transport": tries, **ends}
        path = folder / f"{side}.json5"
        path.write_text(json.dumps(config))
        program = ["ip", "netns", "exec", name, sys.executable, "-m", "palpate.main", "teleop", side]
        out = ["--link", str(path), "-o", str(folder / f"{side}.mcap")]
        running.append(subprocess.Popen([*program, *commands[side], *out]))
    until_s = time.monotonic() + LIMIT_S
    try:
        for process in reversed(running):
            process.wait(until_s - time.monotonic())
    finally:
        for process in running:
            process.kill()
    return join(*(Session.open(folder / f"{side}.mcap") for side in SIDES))


if __name__ == "__main__":
    main()
