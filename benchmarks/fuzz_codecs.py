"""Feeds every codec with random and damaged frames, and says what it believed.

Run: python benchmarks/fuzz_codecs.py [inputs per codec, default 1000000] [codec ...]
"""

import sys
import time

import numpy as np
from fuzzers import all_fuzzers, run_fuzzer


def main() -> None:
    """Fuzz, print a line per codec, and exit with 1 if one of them misbehaved."""
    inputs = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    fuzzers = all_fuzzers()
    misbehaved = False
    print(
        f"{'codec':<20}{'inputs':>10}{'accepted':>10}{'refused':>10}{'wrong':>7}{'crashes':>9}{'slowest':>12}"
    )
    for name in sys.argv[2:] or fuzzers:
        start_s = time.perf_counter()
        result = run_fuzzer(fuzzers[name](), inputs, np.random.default_rng(0))
        print(
            f"{name:<20}{result.inputs:>10}{result.accepted:>10}{result.refused:>10}{len(result.wrong):>7}"
            f"{len(result.crashes):>9}{result.slowest_s * 1e3:>9.2f} ms"
            f"  in {time.perf_counter() - start_s:.0f} s"
        )
        for line in (result.wrong + result.crashes)[:5]:
            print("   ", line)
        misbehaved |= bool(result.wrong or result.crashes)
    sys.exit(1 if misbehaved else 0)


if __name__ == "__main__":
    main()
