"""Command line, processes, tables and files that several benchmarks share."""

import json
import multiprocessing
import resource
import subprocess
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]
from rich.console import Console
from rich.table import Column, Table
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[1]
ROBOTS = ROOT / "robots"
PALPATE = (sys.executable, "-m", "palpate.main")
# The command's main process finally reports its memory, in KiB on Linux.
_MEASURED = """import atexit, resource, sys
from palpate.main import main
atexit.register(lambda: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr))
main()"""


def arguments(description: str | None) -> ArgumentParser:
    """Return a parser whose help shows the script's docstring line by line."""
    return ArgumentParser(description=description, formatter_class=RawDescriptionHelpFormatter)


@dataclass(frozen=True)
class FinishedCommand:
    """A palpate command that has ended."""

    stdout: str
    stderr: str
    exit_code: int
    wall_s: float
    processor_s: float  # user and system time, including processes that it started
    peak_gb: float  # memory of the main process; NaN if the command failed


def run_palpate(*words: object, check: bool = True, timeout_s: float | None = None) -> FinishedCommand:
    """Run a palpate command in its own process, and measure it.

    Args:
        words: command and options.
        check: whether an exit code other than 0 is an error.
        timeout_s: time after which the command is killed [s].

    Raises:
        subprocess.CalledProcessError: the command failed; only with `check`.
        subprocess.TimeoutExpired: it took longer than `timeout_s`.
    """
    begun_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-P", "-c", _MEASURED, *map(str, words)]
    ended = subprocess.run(command, capture_output=True, text=True, check=check, timeout=timeout_s)
    wall_s, after = time.perf_counter() - begun_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    processor_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    *said, last = ended.stderr.splitlines() or [""]
    peak_gb = int(last) * 1024 / 1e9 if last.isdigit() else float("nan")
    stderr = "\n".join(said if last.isdigit() else [*said, last])
    return FinishedCommand(ended.stdout, stderr, ended.returncode, wall_s, processor_s, peak_gb)


def parallel(work: Callable[..., Any], jobs: Iterable[Sequence[Any]], processes: int) -> Iterator[Any]:
    """Yield the results of a function as they finish, computed in processes with one BLAS thread each.

    Args:
        work: function of a module.
        jobs: its arguments, one sequence for each call.
        processes: number of processes.
    """
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, spawn, initializer=threadpool_limits, initargs=(1,)) as pool:
        tasks = [pool.submit(work, *job) for job in jobs]
        try:
            for task in as_completed(tasks):
                yield task.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)  # otherwise the other jobs run before the error is shown
            raise


def resident_mb(process: psutil.Process) -> float:
    """Return the resident memory of a process and all its descendants [MB]."""
    every = (process, *process.children(recursive=True))
    return float(sum(member.memory_info().rss for member in every)) / 1e6


@contextmanager
def json_lines(path: Path | None, mode: str = "w") -> Iterator[Callable[[Any], None]]:
    """Yield a function that writes a value as a line of JSON at once; without a path it writes nothing."""
    if path is None:
        yield lambda value: None
        return
    with path.open(mode, encoding="utf-8") as file:
        yield lambda value: print(json.dumps(value), file=file, flush=True)


def print_table(title: str, headers: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table whose columns, except the first, are aligned to the right."""
    table = Table(*(Column(name, justify="right" if i else "left") for i, name in enumerate(headers)))
    for row in rows:
        table.add_row(*map(str, row))
    Console(width=None if Console().is_terminal else 200).print(title, table, markup=False)
