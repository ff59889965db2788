"""How accurate every estimator is: the paper's grid on the simulated arm, its noise study, and Hunt-Crossley.

    python benchmarks/accuracy.py [--quick | --full]

By default 16 objects (about a minute and a half); --quick takes 4, --full the paper's whole range with three
noises each (the better part of an hour).
"""

import argparse
import time

from accuracy_study import grid, hunt_crossley, noise

GRIDS = {
    "quick": ((500.0, 2000.0), (0.0, 100.0), 1),
    "default": ((200.0, 500.0, 1000.0, 2000.0), (0.0, 20.0, 50.0, 100.0), 1),
    "full": (tuple(range(200, 2001, 200)), tuple(range(0, 101, 10)), 3),
}
DRAWS = {"quick": 20, "default": 100, "full": 300}


def main() -> None:
    """Run the studies and print their tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_const", const="quick", dest="size", default="default")
    size.add_argument("--full", action="store_const", const="full", dest="size")
    chosen = parser.parse_args().size
    begun = time.perf_counter()
    stiffnesses, dampings, seeds = GRIDS[chosen]
    grid.print_table(grid.run_grid(stiffnesses, dampings, seeds))
    noise.run_study(DRAWS[chosen])
    hunt_crossley.run_study(max(10, DRAWS[chosen] // 4))
    print(f"\n{time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
