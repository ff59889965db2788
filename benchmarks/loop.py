"""What a tick costs: a probing run of the simulated follower on simulated time, with a session."""

import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from control.probing.plan import ProbingPlan
from palpate.runs.probing import ProbingJob, run_probing
from palpate.runs.robots import find_robot


def main() -> None:
    """Probe the default object at three speeds, with online estimation, as fast as the machine can."""
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        job = ProbingJob(find_robot("follower"), Path(folder) / "probing.mcap", ProbingPlan())
        run = run_probing(job).loop
    run.raise_for_trip()
    table = Table("section", *(Column(name, justify="right") for name in ("p50", "p99", "p99.9", "max")))
    for name, section in run.timing.items():
        times_s = (section.p50_s, section.p99_s, section.p999_s, section.max_s)
        table.add_row(name, *(f"{1e6 * time_s:.1f}" for time_s in times_s))
    console.print("Probing on simulated time; the engine steps between the ticks \\[us]", table)
    ratio = run.duration_s / run.wall_s
    console.print(f"{run.one_line()}; {run.duration_s:.1f} s simulated, {ratio:.1f} times real time")


if __name__ == "__main__":
    main()
