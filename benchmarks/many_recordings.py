"""Measure the cost and the findings of many recordings, which plain numpy generates.

python benchmarks/many_recordings.py --part speed --recordings 40  # of 5,000 samples
python benchmarks/many_recordings.py --part memory --rows 100000    # peak memory of the client
python benchmarks/many_recordings.py --part alarms --years 20       # of a trend without changes
"""

import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import arguments, run_palpate

import palpate
from palpate.batches import run as batch_run
from palpate.batches.trend import Series, find_changes
from palpate.sweep import Case, Cluster, ResultStore
from palpate.sweep.runner import Progress, SweepReport


def presses(folder: Path, number: int, samples: int = 5000) -> Path:
    """Write a new folder of recordings: five presses each of a damped spring."""
    folder.mkdir()
    t, run = np.arange(samples // 5) / 500.0, np.repeat(np.arange(5), samples // 5)
    rates = 2.0 * np.pi * np.array([2.0, 3.0, 4.0, 3.0, 2.0]) / t[-1]
    x = np.concatenate([0.0045 - 0.0055 * np.cos(rate * t) for rate in rates])
    v = np.concatenate([0.0055 * rate * np.sin(rate * t) for rate in rates])
    for item in range(number):
        rng = np.random.default_rng(item)
        stiffness = 400.0 * (1.0 + 0.03 * rng.standard_normal())
        force = np.where(x > 0.0, np.maximum(stiffness * x + 4.0 * v, 0.0), 0.0)
        columns = [np.tile(t, 5), x, force + rng.normal(0.0, 0.02, len(x)), run]
        names, file = "time_s,displacement_m,force_N,run", folder / f"r{item}.csv"
        np.savetxt(file, np.column_stack(columns), delimiter=",", header=names, comments="", fmt="%.8g")
    return folder


def speed(folder: Path, number: int) -> None:
    """Time a batch with one and with two workers."""
    data = presses(folder / "data", number)
    for name, options in (("estimate and compare", ()), ("with diagnosis", ("--diagnose",))):
        one, two = (
            run_palpate("batch", data, "--out", folder / f"{name} {workers}", "--workers", workers, *options)
            for workers in (1, 2)
        )
        print(
            f"{name}: {number} recordings by two workers {two.wall_s:.1f} s, by one {one.wall_s:.1f} s "
            f"({one.wall_s / two.wall_s:.2f} times)"
        )


def write_rows(folder: Path, addresses: Sequence[str]) -> None:
    """Store a row with ten parameters for each case, as a worker does."""
    store, rng = ResultStore(folder), np.random.default_rng(int(addresses[0][:8], 16))
    row: dict[str, Any] = {"channel": "contact", "model": "kelvin_voigt", "verdict": "", "warnings": ""}
    row |= {"times_noise": 1.0, "seconds": 0.1, "error": "", "seed": 0, "first": True}
    names = [f"effect.p{item}{end} [N]" for item in range(10) for end in ("", " low", " high", " std_err")]
    for address in addresses:
        store.write(address, [row | {name: float(rng.normal(5.0, 0.1)) for name in names}])


def memory(folder: Path, rows: int) -> None:
    """Measure the peak memory of a client whose workers write rows with ten parameters."""
    (data := folder / "data").mkdir()
    for number in range(rows):
        (data / f"r{number}.csv").write_text(f"a\n{number}\n")

    def write_cases(
        cases: Sequence[Case], store: ResultStore, _cluster: Cluster, progress: Progress
    ) -> SweepReport:
        with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
            for first in range(0, len(cases), 1000):
                addresses = [case.address for case in cases[first : first + 1000]]
                halves = [half for half in (addresses[::2], addresses[1::2]) if half]
                list(pool.map(write_rows, [store.folder] * len(halves), halves))
                store.pack()
                progress(first + len(addresses), len(cases))
        return SweepReport(0, len(cases), (), 0.0)

    batch_run.run_cases = write_cases
    begun_s = time.perf_counter()
    result = palpate.batch(data, out=folder / "out")
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{len(result.table):,} rows: {most:.0f} MB, {time.perf_counter() - begun_s:.0f} s without the work"
    )


def alarms(_folder: Path, years: int, seed: int) -> None:
    """Count the alarms of a nightly job over years without a change, in four series of a growing table."""
    rng, count, alarmed = np.random.default_rng(seed), 0, 0
    for _ in range(years):
        before = count
        unchanged = rng.standard_normal((4, 365))
        known: set[tuple[int, str, int]] = set()
        for night in range(10, 366):
            for item, values in enumerate(unchanged):
                nights, errors = np.arange(night), np.full(night, 0.005)
                seen = 1.0 + 0.04 * values[:night]
                series = Series("all", "axis", "p", "N m", nights, nights.astype(float), seen, errors)
                for change in find_changes(series, 0.01 / 4):
                    key = (item, change.kind, change.first)
                    count += not any(k[:2] == key[:2] and abs(k[2] - key[2]) <= 5 for k in known)
                    known.add(key)
        alarmed += count > before
    print(f"{years} quiet years of four series, tested nightly: {count} alarms, in {alarmed} years")


PARTS: dict[str, tuple[Callable[..., None], tuple[str, ...]]] = {  # with the options that each needs
    "speed": (speed, ("recordings",)),
    "memory": (memory, ("rows",)),
    "alarms": (alarms, ("years", "seed")),
}


def main() -> None:
    """Measure one part."""
    parser = arguments(__doc__)
    parser.add_argument("--part", choices=PARTS, required=True)
    parser.add_argument("--recordings", type=int, default=30)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--years", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="of alarms")
    asked = parser.parse_args()
    part, names = PARTS[asked.part]
    with TemporaryDirectory() as folder:
        part(Path(folder), *(getattr(asked, name) for name in names))
    print("load", *(f"{load:.1f}" for load in os.getloadavg()))


if __name__ == "__main__":
    main()
