"""Hides effects in made-up sessions and counts how often the diagnosis is right.

    python benchmarks/hidden_effects.py [--quick | --small | --sample N] [--kind contact|revolute] [--seed 0]
                                        [--ways] [--out FILE]
    python benchmarks/hidden_effects.py --simulated [--quick] [--seed 0]

Two processes by default (--processes). `--ways` adds sessions read through an arm's encoders, of stiff
objects, with coarse steps, without velocities and of other controllers, in rows of their own. `--out` writes
JSON lines.

The sessions come from `synthetic/`, which shares no code with the effects that find them. Strength is the RMS
of what the base model cannot mimic over the noise; cells that an effect cannot reach are left out. With
`--simulated` they are probing runs of the simulated arm, with the simulator's own hidden effects.
"""

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.progress import track
from simulated.probing import drawable, probe
from synthetic.grid import BASE, FULL, QUICK, SMALL, jobs, other_ways, run
from synthetic.tally import report, share
from threadpoolctl import threadpool_limits

from estimation.channel import ChannelKind


def run_simulated(options: argparse.Namespace) -> None:
    """Probe the simulated arm with each effect hidden once, and a few times with nothing."""
    shown = drawable()[::5] if options.quick else drawable()
    hidden = ["" for _ in range(2 if options.quick else 10)] + shown
    with TemporaryDirectory() as folder, _pool(options.processes) as pool:
        tasks = [
            pool.submit(probe, effect, options.seed + number, Path(folder))
            for number, effect in enumerate(hidden)
        ]
        probed = []
        for task in tasks:
            probed.append(task.result())
            one = probed[-1]
            print(
                f"{'right' if one.is_right else 'WRONG'} | {one.hidden or 'nothing'} | {one.told}", flush=True
            )
    print(f"nothing hidden: right {share([one.is_right for one in probed if not one.effect])}")
    print(f"one effect hidden: right {share([one.is_right for one in probed if one.effect])}")


def _pool(processes: int) -> ProcessPoolExecutor:
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, spawn, initializer=threadpool_limits, initargs=(1,))


def main() -> None:
    """Run the grid."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one seed, one strength")
    parser.add_argument("--small", action="store_true", help="one seed, about a quarter of an hour")
    parser.add_argument("--sample", type=int, help="so many sessions of the full grid, drawn by chance")
    parser.add_argument("--kind", choices=["contact", "revolute"], help="one kind of channel only")
    parser.add_argument("--simulated", action="store_true", help="probing runs of the simulated arm")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--ways", action="store_true", help="other motions and readings as well")
    parser.add_argument("--out", type=Path, help="JSON lines, one a session")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    if options.simulated:
        run_simulated(options)
        return
    kinds = [ChannelKind(options.kind)] if options.kind else list(BASE)
    written = []
    for kind in kinds:
        print(f"\n== {kind.value}, base model {BASE[kind]}", flush=True)
        size = QUICK if options.quick else SMALL[kind] if options.small else FULL
        grid = list(jobs(kind, size, options.seed))
        if options.sample is not None:
            np.random.default_rng(0).shuffle(grid)
            grid = grid[: options.sample]
        if options.ways:
            grid += other_ways(kind, size, options.seed)
        with _pool(options.processes) as pool:
            found = track(pool.map(run, grid, chunksize=1), "diagnosing", total=len(grid))
            outcomes = [outcome for outcome in found if outcome is not None]
        report(outcomes)
        written += [outcome.record() for outcome in outcomes]
    if options.out:
        options.out.write_text("\n".join(written) + "\n")


if __name__ == "__main__":
    main()
