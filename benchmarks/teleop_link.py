"""The line of a teleoperation: mutated messages, what our link costs, how punctual the haptic loop is.

python benchmarks/teleop_link.py fuzz [--number 100000] [--seed 1]
python benchmarks/teleop_link.py overhead
python benchmarks/teleop_link.py haptics [--seconds 10] [--times 3]
python benchmarks/teleop_link.py demo [--times 3]
"""

import tempfile
from pathlib import Path

import numpy as np
from command_line import arguments

from benchmarks.teleop.driven import distinct, drive
from benchmarks.teleop.fuzz import fuzz
from benchmarks.teleop.overhead import codec, overhead
from benchmarks.teleop.punctuality import alone, in_demo, in_words
from palpate.teleop.leader import TALK_S
from robot_io.link.seal import CHECKSUM, key_seal


def main() -> None:
    """Run one of the four."""
    parser = arguments(__doc__)
    parser.add_argument("what", choices=("fuzz", "overhead", "haptics", "demo"))
    parser.add_argument("--number", type=int, default=100_000, help="frames of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--times", type=int, default=3)
    options = parser.parse_args()
    if options.what == "fuzz":
        show_fuzz(options.number, options.seed)
    elif options.what == "overhead":
        print(codec())
        print(overhead(2000, 0.0))
        print(overhead(500, TALK_S))
    else:
        found = []
        for _ in range(options.times):
            found.append(alone(options.seconds) if options.what == "haptics" else in_demo())
            print(in_words(*found[-1]), flush=True)
        ours, references = zip(*found, strict=True)
        if options.times > 1 and not isinstance(references[0], str):
            print(f"all of these\n{in_words(np.concatenate(ours), np.concatenate(references))}")


def show_fuzz(number: int, seed: int) -> None:
    """As many of each kind; what is taken then moves the simulated arm."""
    ours, theirs = key_seal(b"of the pair"), key_seal(b"of somebody else")
    for what, seals in {
        "damaged on the way": (CHECKSUM, None),
        "sealed by an attacker, the pair without a key": (CHECKSUM, CHECKSUM),
        "sealed by an attacker with another key": (ours, theirs),
    }.items():
        result = fuzz(number, seed, *seals)
        print(f"{number} frames to each side, {what}: no exception; {dict(+result.counts)}")
        print(f"  other targets taken: {len(result.targets)}; felt: {result.felt}", flush=True)
        if places := distinct(result.targets):
            with tempfile.TemporaryDirectory() as folder:
                print(f"  {len(places)} places and directions; {drive(places, Path(folder)).in_words()}")


if __name__ == "__main__":
    main()
