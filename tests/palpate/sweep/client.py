"""A client that runs twelve slow cases: `python -m tests.palpate.sweep.client FOLDER [SCHEDULER]`."""

import sys
from pathlib import Path

from palpate.robot_io.errors import PalpateError
from palpate.sweep import Case, Cluster, ResultStore, run_cases

WORK = "tests.palpate.sweep.slow_work:work"


def cases(folder, seconds=0.4):
    parameters = {"starts": str(folder / "starts"), "seconds": seconds}
    return [Case(WORK, parameters, seed) for seed in range(12)]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    cluster = Cluster(sys.argv[2] if len(sys.argv) > 2 else None, workers=2)
    try:
        print(run_cases(cases(folder), ResultStore(folder / "results"), cluster).finished_now)
    except PalpateError as error:
        sys.exit(f"palpate: {error}")
