"""Hides effects in made-up sessions and counts how often the diagnosis is right.

    python benchmarks/hidden_effects.py [--quick | --small | --sample N] [--kind contact|revolute] [--seed 0]
                                        [--ways] [--out FILE] [--results FOLDER] [--scheduler ADDRESS]

Sessions are cases of a sweep (docs/studies.md): two processes by default, or a scheduler's workers; with
`--results` a killed benchmark goes on where it was. `--ways` adds sessions read through an arm's encoders, of
stiff objects, with coarse steps, without velocities and of other controllers, in rows of their own. `--out`
writes JSON lines.

The sessions come from `synthetic/`, which shares no code with the effects that find them. Strength is the RMS
of what the base model cannot mimic over the noise; cells that an effect cannot reach are left out.
"""

from pathlib import Path

import numpy as np
from command_line import arguments
from swept import worked_out
from synthetic.grid import BASE, FULL, QUICK, SMALL, Outcome, case_of, jobs, other_ways
from synthetic.tally import report

from estimation.channel import ChannelKind
from palpate.sweep import Cluster


def main() -> None:
    """Run the grid."""
    parser = arguments(__doc__)
    parser.add_argument("--quick", action="store_true", help="one seed, one strength")
    parser.add_argument("--small", action="store_true", help="one seed, about a quarter of an hour")
    parser.add_argument("--sample", type=int, help="so many sessions of the full grid, drawn by chance")
    parser.add_argument("--kind", choices=["contact", "revolute"], help="one kind of channel only")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--ways", action="store_true", help="other motions and readings as well")
    parser.add_argument("--out", type=Path, help="JSON lines, one a session")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--results", type=Path, help="folder of results, to go on from; default: a new one")
    parser.add_argument("--scheduler", help="address of a dask scheduler, whose workers see that folder")
    options = parser.parse_args()
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
        cluster = Cluster(options.scheduler, options.processes)
        rows = worked_out([case_of(job) for job in grid], options.results, cluster)
        outcomes = [Outcome.from_row(row) for of_case in rows for row in of_case if row["outcome"]]
        report(outcomes)
        written += [outcome.record() for outcome in outcomes]
    if options.out:
        options.out.write_text("\n".join(written) + "\n")


if __name__ == "__main__":
    main()
