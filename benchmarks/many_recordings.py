"""Measure the cost and the findings of many recordings, which plain numpy generates.

python benchmarks/many_recordings.py --part speed --recordings 40  # of 5,000 samples
python benchmarks/many_recordings.py --part memory --rows 100000    # peak memory of the client
python benchmarks/many_recordings.py --part pooled --repeats 5      # effects half as large as the noise
python benchmarks/many_recordings.py --part trend --repeats 20 --years 4
"""

import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import date, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from harness import arguments, run_palpate
from threadpoolctl import threadpool_limits

import palpate
from palpate.batches import run as batch_run
from palpate.batches.tasks.measuring import measure
from palpate.batches.trend import Series, find_changes
from palpate.estimation.data.import_options import NO_OPTIONS
from palpate.sweep import Case, Cluster, ResultStore
from palpate.sweep.runner import Progress, SweepReport

NOISE_N = 0.02


def write_press(path: Path, seed: int, samples: int, hidden: float = 0.0) -> None:
    """Write five presses of a damped spring with a cubic part of `hidden` times the noise."""
    rng = np.random.default_rng(seed)
    count = samples // 5
    t = np.arange(count) / 500.0
    stiffness = 400.0 * (1.0 + 0.03 * rng.standard_normal())
    depths, rates = [], []
    for cycles in (2, 3, 4, 3, 2):
        angle = 2.0 * np.pi * cycles * t / t[-1]
        depths.append(0.0045 - 0.0055 * np.cos(angle))
        rates.append(0.0055 * 2.0 * np.pi * cycles / t[-1] * np.sin(angle))
    x, v = np.concatenate(depths), np.concatenate(rates)
    inside = x > 0.0
    law = np.column_stack([x, v])[inside]
    cubic = x[inside] ** 3
    rest = cubic - law @ np.linalg.lstsq(law, cubic, rcond=None)[0]
    force = np.where(inside, np.maximum(stiffness * x + 4.0 * v, 0.0), 0.0)
    force[inside] += hidden * NOISE_N * cubic / np.sqrt(np.mean(rest**2))
    columns = [np.tile(t, 5), x, force + rng.normal(0.0, NOISE_N, len(x)), np.repeat(np.arange(5), count)]
    write(path, "time_s,displacement_m,force_N,run", columns)


def write_log(path: Path, seed: int, coulomb: float) -> None:
    """Write a night's log of one axis, three runs of 5 s, whose Coulomb friction [N m] scatters by 4 %."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 5.0, 0.01)
    friction = coulomb * (1.0 + 0.04 * rng.standard_normal())
    rows = []
    for run, w in enumerate((2.0, 3.0, 4.0)):
        q, v, a = 0.8 * np.sin(w * t), 0.8 * w * np.cos(w * t), -0.8 * w**2 * np.sin(w * t)
        effort = 0.05 * a + 0.1 * v + friction * np.tanh(v / 0.005) + rng.normal(0.0, 0.02, len(t))
        rows.append(np.column_stack([t, q, v, a, effort, np.full(len(t), run)]))
    names = "time_s,position_rad,velocity_rad_s,acceleration_rad_s2,torque_Nm,run"
    write(path, names, list(np.vstack(rows).T))


def write(path: Path, names: str, columns: Sequence[np.ndarray]) -> None:
    """Write columns, each of shape (n,), as CSV with a header of names."""
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="", fmt="%.8g")


def presses(folder: Path, number: int, samples: int = 5000, hidden: float = 0.0, seed: int = 0) -> Path:
    """Write a new folder of recordings with different seeds; see `write_press`."""
    folder.mkdir()
    for item in range(number):
        write_press(folder / f"r{item}.csv", 100_000 * seed + item, samples, hidden)
    return folder


def speed(folder: Path, number: int) -> None:
    """Compare a batch with one worker to the same work in this process, and time it with two workers."""
    data, single = presses(folder / "data", number), presses(folder / "single", 1)
    plain = {"model": None, "add": [], "urdf": None, "tip_frame": None, "effects": []}
    plain["read"] = NO_OPTIONS.stated()
    for name, options in (("estimate and compare", ()), ("with diagnosis", ("--diagnose",))):
        asked = {"where": {}, "options": plain | {"diagnose": bool(options)}}
        with threadpool_limits(1):
            measure([data / "r0.csv"], asked)  # loads the libraries
            begun_s = time.process_time()
            for file in data.iterdir():
                measure([file], asked)
            alone_s = time.process_time() - begun_s
        empty, used, two = (
            run_palpate("batch", of, "--out", folder / f"{name} {out}", *workers, *options)
            for of, out, workers in (
                (single, "of one", ()),
                (data, "by one", ("--workers", 1)),
                (data, "by two", ("--workers", 2)),
            )
        )
        ratio = (used.processor_s - empty.processor_s) / (alone_s * (number - 1) / number)
        print(
            f"{name}: {number} recordings by two workers {two.wall_s:.1f} s, by one {used.wall_s:.1f} s "
            f"({used.wall_s / two.wall_s:.2f} times); processor time over that of the work alone "
            f"({alone_s / number:.2f} s each) {ratio - 1:+.1%}, beside {empty.processor_s:.1f} s for one"
        )


def write_rows(folder: Path, addresses: Sequence[str]) -> None:
    """Store a row with ten parameters for each case, as a worker does."""
    store, rng = ResultStore(folder), np.random.default_rng(int(addresses[0][:8], 16))
    row: dict[str, Any] = {"channel": "contact", "model": "kelvin_voigt", "verdict": "", "warnings": ""}
    row |= {"times_noise": 1.0, "seconds": 0.1, "error": "", "seed": 0, "first": True}
    for address in addresses:
        for item in range(10):
            for end in ("", " low", " high", " std_err"):
                row[f"effect.p{item}{end} [N]"] = float(rng.normal(5.0, 0.1))
        store.write(address, [row])


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


def pooled(folder: Path, repeats: int, seed: int) -> None:
    """Count batches of 40 short recordings in which pooling names a hidden effect, or an absent one."""
    named = {0.5: 0, 0.0: 0}
    for repeat in range(repeats):
        for hidden in named:
            place = folder / f"{repeat}_{hidden}"
            data = presses(place, 40, samples=750, hidden=hidden, seed=2 * (seed + repeat) + (hidden > 0))
            found = palpate.batch(data, out=f"{place}_out", pool=True, workers=2).common_effects
            names = {name for effect in found for name in (effect.effect, *effect.confused_with)}
            named[hidden] += "cubic_stiffness" in names if hidden else bool(found)
        counts = f"found {named[0.5]}, false {named[0.0]} of {repeat + 1}"
        print(f"effect of half the noise in 40 recordings: {counts}", flush=True)


def trend(folder: Path, repeats: int, years: int, seed: int) -> None:
    """Date a step of friction in nightly logs; count alarms of a nightly job over years without a change."""
    dated = 0
    for repeat in range(repeats):
        (logs := folder / f"logs{repeat}").mkdir()
        step = 15 + (7 * repeat) % 30
        for night in range(60):
            day = (date(2026, 1, 1) + timedelta(night)).isoformat()
            write_log(logs / f"{day}.csv", 1000 * (seed + repeat) + night, 0.33 if night >= step else 0.3)
        batched = palpate.batch(
            logs, out=folder / f"out{repeat}", pattern="{date}.csv", model="inertia",
            add=["coulomb_friction"], workers=2,
        )  # fmt: skip
        name = "coulomb_friction.force [N m]"
        table = batched.table.sort_by("measurement")
        values, errors = (table[head].to_numpy() for head in (name, name.replace(" [", " std_err [")))
        changes = find_changes(series(values, errors), 0.01 / 4)
        dated += any(each.kind == "step" and abs(each.first - step) <= 3 for each in changes)
        print(f"step of 10 % in 60 logs: dated within 3 nights in {dated} of {repeat + 1}", flush=True)
    rng, alarms, alarmed = np.random.default_rng(seed), 0, 0
    for _ in range(years):
        before = alarms
        unchanged = rng.standard_normal((4, 365))  # four series of a table that grows for a year
        known: set[tuple[int, str, int]] = set()
        for night in range(10, 366):
            for item, values in enumerate(unchanged):
                for change in find_changes(
                    series(1.0 + 0.04 * values[:night], np.full(night, 0.005)), 0.01 / 4
                ):
                    key = (item, change.kind, change.first)
                    alarms += not any(k[:2] == key[:2] and abs(k[2] - key[2]) <= 5 for k in known)
                    known.add(key)
        alarmed += alarms > before
    print(f"{years} quiet years of four series, tested nightly: {alarms} alarms, in {alarmed} years")


def series(values: np.ndarray, errors: np.ndarray) -> Series:
    """Make a series of one value per night, of shape (n,), with standard errors (n,)."""
    nights = np.arange(len(values))
    return Series("all", "axis", "p", "N m", nights, nights.astype(float), values, errors)


PARTS: dict[str, tuple[Callable[..., None], tuple[str, ...]]] = {  # with the options that each needs
    "speed": (speed, ("recordings",)),
    "memory": (memory, ("rows",)),
    "pooled": (pooled, ("repeats", "seed")),
    "trend": (trend, ("repeats", "years", "seed")),
}


def main() -> None:
    """Measure one part."""
    parser = arguments(__doc__)
    parser.add_argument("--part", choices=PARTS, required=True)
    parser.add_argument("--recordings", type=int, default=30)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=3, help="batches of pooled and trend")
    parser.add_argument("--years", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="of pooled and trend")
    asked = parser.parse_args()
    part, names = PARTS[asked.part]
    with TemporaryDirectory() as folder:
        part(Path(folder), *(getattr(asked, name) for name in names))
    print("load", *(f"{load:.1f}" for load in os.getloadavg()))


if __name__ == "__main__":
    main()
