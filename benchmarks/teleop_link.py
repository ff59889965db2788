"""The line of a teleoperation: mutated messages, what our link costs, how punctual the haptic loop is.

python benchmarks/teleop_link.py fuzz [--number 100000] [--seed 1]
python benchmarks/teleop_link.py overhead
python benchmarks/teleop_link.py haptics [--seconds 10] [--times 3]
python benchmarks/teleop_link.py demo [--times 3]
"""

from command_line import arguments

from benchmarks.teleop.fuzz import fuzz
from benchmarks.teleop.overhead import codec, overhead
from benchmarks.teleop.punctuality import alone, in_demo, in_words


def main() -> None:
    """Run one of the four."""
    parser = arguments(__doc__)
    parser.add_argument("what", choices=("fuzz", "overhead", "haptics", "demo"))
    parser.add_argument("--number", type=int, default=100_000, help="frames")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--times", type=int, default=3)
    options = parser.parse_args()
    if options.what == "fuzz":
        show_fuzz(options.number, options.seed)
    elif options.what == "overhead":
        print(codec())
        print(overhead())
    else:
        for _ in range(options.times):
            print(in_words(*(alone(options.seconds) if options.what == "haptics" else in_demo())), flush=True)


def show_fuzz(number: int, seed: int) -> None:
    """Half of them with a checksum that fits what was mutated."""
    for mended in (False, True):
        result = fuzz(number // 2, seed, mended=mended)
        what = "checksum mended by an attacker" if mended else "damaged on the way"
        print(f"{number // 2} frames to each side, {what}: no exception; {dict(+result.counts)}")
        print(f"  other targets taken, for plan and guard: {len(result.targets)}; felt: {result.felt}")


if __name__ == "__main__":
    main()
