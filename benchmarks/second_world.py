"""Judge the diagnosis on cases from a second world, whose author had read only the vocabulary.

    python benchmarks/second_world.py [--sample N] [--seed S] [--kind contact|revolute] [--processes 2]
                                      [--case NUMBER] [--removed] [--out FILE [--resume]]
    python benchmarks/second_world.py --table FILE

There are some 250 cases: nothing hidden, one effect at 3, 10 or 30 floors, two effects, and laws outside the
vocabulary. A floor is the RMS error that noise of effort and position causes. A strength is the RMS of what
the simple model cannot mimic. Seed and number determine a case. `--out` writes one JSON line for each case,
from which `--table` makes the tables again. With `--removed`, the cases with one effect are diagnosed with a
library that lacks this effect and every law that contains it: the right verdict is unexplained.
"""

from dataclasses import asdict, replace
from pathlib import Path

from harness import arguments, json_lines, parallel
from pydantic import TypeAdapter
from second_generator.cases import grid
from second_generator.judge import CaseOutcome, run, table


def read(path: Path) -> list[CaseOutcome]:
    """Read the outcomes of an earlier run."""
    return [TypeAdapter(CaseOutcome).validate_json(line) for line in path.read_text().splitlines()]


def main() -> None:
    """Run the cases, or compare two runs."""
    parser = arguments(__doc__)
    parser.add_argument("--sample", type=int, help="only so many; the order mixes all sorts")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=["contact", "revolute"])
    parser.add_argument("--case", type=int, help="this one only")
    parser.add_argument("--removed", action="store_true", help="one effect, which the library lacks")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, help="JSON lines")
    parser.add_argument("--resume", action="store_true", help="leave out what --out holds already")
    parser.add_argument("--table", type=Path, metavar="FILE")
    options = parser.parse_args()
    if options.table:
        print(table(read(options.table)))
        return
    every = grid()
    if options.removed:
        every = [replace(job, sort="removed") for job in every if job.sort == "one"]
    jobs = [job for job in every if options.kind in (None, job.kind)][: options.sample]
    if options.case is not None:
        jobs = [job for job in every if job.number == options.case]
    outcomes = read(options.out) if options.resume and options.out.exists() else []
    done = {(outcome.seed, outcome.job.number) for outcome in outcomes}
    tasks = [(job, options.seed) for job in jobs if (options.seed, job.number) not in done]
    with json_lines(options.out, "a" if options.resume else "w") as write:
        for outcome in filter(None, parallel(run, tasks, options.processes)):
            outcomes.append(outcome)
            print(outcome.line(), flush=True)
            write(asdict(outcome))
    outcomes.sort(key=lambda outcome: outcome.job.number)
    print(f"\n{len(jobs) - len(outcomes)} of {len(jobs)} cases cannot be hidden in any world drawn")
    print(f"\n{table(outcomes)}")


if __name__ == "__main__":
    main()
