"""`palpate sweep`: probe many simulated objects, such as the paper's, with every estimator."""

import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from palpate.common import console
from palpate.common.console import count, display_path, duration, shell_path
from palpate.common.files import existing_file, output_folder
from palpate.common.options import JsonOption, SchedulerOption, WorkersOption
from palpate.render.progress import sweep_progress
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.extras import install_command
from palpate.sim_backend.engines import installed_engines

PAPER = "paper"
SWEEPS = Path("sweeps")
_SAMPLE = 4  # cases to run for an estimate of the cost


_PLAN = (
    "Show the number of remaining cases and the time they need; if no case is done, run a few to measure "
    "the time."
)
_OUT = "Output folder; if it contains an interrupted sweep, this sweep continues."


def sweep_command(
    what: Annotated[str, Argument(help="paper, or a YAML file with your own grid.", metavar="paper|FILE")],
    *,
    out: Annotated[Path | None, Option("--out", "-o", help=_OUT)] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    limit: Annotated[int | None, Option(help="Run only the first N cases.", min=1)] = None,
    plan: Annotated[bool, Option("--plan", help=_PLAN)] = False,
    as_json: JsonOption = False,
) -> None:
    """Probe many simulated objects, estimate with every method, and write figures, tables and a web page.

    To continue after an interruption, run the same command again; no finished case is repeated.

    Examples:
      palpate sweep paper --out paper
      palpate sweep mine.yaml --workers 2
      palpate sweep mine.yaml --plan
      palpate sweep mine.yaml --scheduler tcp://10.0.0.5:8786 --out /shared/mine
    """
    if not installed_engines() or not find_spec("pinocchio"):
        raise InputError(f"a sweep simulates arms and needs more packages: {install_command('sweep')}")
    if plan and limit is not None:
        raise InputError(f"--limit {limit}: --plan estimates the time of all cases; omit --limit or --plan")
    from palpate.sweep import (  # noqa: PLC0415, its libraries take a second
        RESULTS,
        Case,
        Cluster,
        ResultStore,
        refuse_other_files,
        run_cases,
    )

    parts: Mapping[str, Sequence[Case]]
    path, grid = Path(what), None
    if what == PAPER:
        from palpate.sweep.paper import paper_cases  # noqa: PLC0415, as above

        parts = paper_cases()
    else:
        from palpate.sweep.grid import load_grid  # noqa: PLC0415, as above

        if not path.suffix and not path.exists():
            raise InputError(f"sweep '{what}': no such grid. Valid: {PAPER}, or a YAML file with a grid")
        grid = load_grid(existing_file(path, "sweep"))
        for words in grid.short_ranges():
            console.warn(f"{path}: {words}")
        parts = {"grid": list({case.address: case for case in grid.cases()}.values())}  # each once
    sweep = PAPER if grid is None else shell_path(path)
    folder = out or SWEEPS / path.stem
    refuse_other_files(folder)
    output_folder(folder)
    store = ResultStore(folder / RESULTS)
    cases = [case for part in parts.values() for case in part]
    chosen = cases[: _SAMPLE if plan and not store.finished() else 0 if plan else limit]
    try:
        with sweep_progress() as progress:
            report = run_cases(chosen, store, Cluster(scheduler, workers), progress)
        rows = {name: store.rows([case.address for case in part]) for name, part in parts.items()}
        # processor time of each finished case [s]
        seconds = {part: [row["seconds"] for row in own if row["first"]] for part, own in rows.items()}
        done, cost = sum(map(len, seconds.values())), sum(map(sum, seconds.values()))
        facts = {
            "cases": f"{done} of {len(cases)}",
            "processor time": f"{duration(cost)}, {cost / max(done, 1):.2f} s a case",
            "command": f"palpate sweep {sweep}",
        }
        page = None
        if grid is not None and not plan:
            from palpate.sweep.report import write_grid  # noqa: PLC0415, matplotlib takes a second

            page = write_grid(folder, path.stem, grid, rows["grid"], facts)
        elif done == len(cases) and not plan:
            from palpate.sweep.paper import write_paper  # noqa: PLC0415, as above

            page = write_paper(folder, rows, facts)
    except KeyboardInterrupt:
        finished = len(store.finished() & {case.address for case in cases})
        console.stderr().print(
            f"{finished} of {len(cases)} cases are done and saved; run the same command again to continue"
        )
        raise
    if plan:
        sizes = {name: len(part) for name, part in parts.items()}
        _present_plan(sizes, seconds, workers or os.cpu_count() or 1, as_json=as_json)
        return
    outcome = {
        "what": sweep,
        "folder": str(folder),
        "page": str(page) if page else None,
        "cases": len(cases),
        "finished": done,
        "finished_now": report.finished_now,
        "wall_s": report.wall_s,
        "cpu_s": cost,
        "errors": sum(bool(row["error"]) for part in rows.values() for row in part),
    }
    console.present(outcome, lambda: _print(outcome, page, report.finished_before), as_json=as_json)
    if report.failures:
        raise PalpateError(f"{count(len(report.failures), 'case')} without a result: {report.failures[0]}")


def _present_plan(
    cases: Mapping[str, int], seconds: Mapping[str, list[float]], processes: int, *, as_json: bool
) -> None:
    """Print how many cases remain, and the time that they need, from the seconds of finished cases [s]."""
    total, done = sum(cases.values()), sum(map(len, seconds.values()))
    known = {name: sum(own) / len(own) for name, own in seconds.items() if own}
    fallback = max(known.values())
    left_s = sum((cases[name] - len(own)) * known.get(name, fallback) for name, own in seconds.items())
    content = {
        "cases": total,
        "finished": done,
        "cpu_s_per_case": known,
        "left_cpu_s": left_s,
        "workers": processes,
        "left_wall_s": left_s / processes,
    }
    each = ", ".join(f"{name} {mean_s:.2f} s" for name, mean_s in known.items())
    words = (
        f"{count(total, 'case')}, {done} done; measured time per case: {each}\n"
        f"remaining: {duration(left_s)} of processor time, {duration(left_s / processes)} on "
        f"{count(processes, 'worker')}"
    )
    console.present(content, lambda: console.stdout().print(words), as_json=as_json)


def _print(outcome: Mapping[str, Any], page: Path | None, before: int) -> None:
    out = console.stdout()
    done, total = outcome["finished"], outcome["cases"]
    already = f", {before} were already done" if before else ""
    out.print(
        f"{done} of {total} cases done: {outcome['finished_now']} in {duration(outcome['wall_s'])}{already}"
    )
    if outcome["errors"]:
        out.print(f"[yellow]{count(outcome['errors'], 'case')} failed[/yellow]; see the page")
    if page is not None:
        console.say(f"written: [bold]{display_path(page)}[/bold], with figures, tables and results beside it")
    if done < total:
        again = f"palpate sweep {outcome['what']} --out {shell_path(Path(outcome['folder']))}"
        rest = "and write the page" if page is None else "and rewrite the page"
        console.next_steps(
            (again, f"run the remaining cases, {rest}"), (f"{again} --plan", "how long they take")
        )
