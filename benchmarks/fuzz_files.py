"""Gives commands files that are damaged or hostile, and says which of them were not refused as they should.

    python benchmarks/fuzz_files.py [files of each kind (100), or FIRST-LAST] [sessions | numbers | texts ...]

Each command runs in a process forked from this one. It has to end by itself within 30 s of processor time
and 2 GB, with one line where it refuses; what it reads must be what an independent reader finds in the file.
"""

import os
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from files_under_fire import numbers, sessions, texts
from files_under_fire.case import Case

MOST_S, MOST_BYTES = 30, 2_000_000_000
_WAITS = 10  # times as long on a clock, where the machine is busy
KINDS: dict[str, Callable[[Path, np.random.Generator], Case]] = {
    "sessions": sessions.case,
    "numbers": numbers.case,
    "texts": texts.case,
}
_ENDS = {0, 1, 2, 3}  # exit codes that say what happened


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (negative: by a signal), what it said, processor time and memory."""

    code: int
    said: str
    took_s: float
    peak_bytes: int

    @property
    def fault(self) -> str:
        """What is wrong with that; empty if nothing is."""
        if self.took_s > MOST_S:
            return f"took {self.took_s:.0f} s"
        if self.peak_bytes > MOST_BYTES:
            return f"took {self.peak_bytes / 1e9:.1f} GB"
        if self.code not in _ENDS:
            return f"ended with {self.code}"
        if "Traceback" in self.said or "internal error" in self.said:
            return "failed without a plain word"
        if self.code and len([line for line in self.said.splitlines() if line.startswith("palpate: ")]) != 1:
            return "refused in other than one line"
        if "\x1b" in self.said:
            return "handed on what a terminal obeys"
        return ""


def run(arguments: list[str], folder: Path) -> Ended:
    """Run a palpate command in a forked process."""
    said, started = folder / "stderr", time.perf_counter()
    process = os.fork()
    if process == 0:
        _be_palpate(arguments, said)
    while True:
        found, status, used = os.wait4(process, os.WNOHANG)
        took_s = time.perf_counter() - started
        if found:
            text, busy_s = said.read_text(errors="replace"), used.ru_utime + used.ru_stime
            return Ended(os.waitstatus_to_exitcode(status), text, busy_s, used.ru_maxrss * 1024)
        if took_s > _WAITS * MOST_S:
            os.kill(process, signal.SIGKILL)
        time.sleep(0.005)


def _be_palpate(arguments: list[str], said: Path) -> None:
    """In the child: be the command, and end."""
    from palpate.app import app  # noqa: PLC0415, imported by the parent already

    os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_S + 1, MOST_S + 1))
    resource.setrlimit(resource.RLIMIT_AS, (4 * MOST_BYTES, 4 * MOST_BYTES))
    sys.argv = ["palpate", *arguments]
    code = 1
    try:
        app()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException as error:  # this is what is looked for
        print(f"Traceback: {type(error).__name__}: {error}", file=sys.stderr)
    sys.stderr.flush()
    os._exit(code)


def fire(kind: str, seeds: range, folder: Path) -> bool:
    """Try files of one kind; true if all was well."""
    ends, well = Counter[int](), True
    slowest_s, most_bytes = 0.0, 0
    for seed in seeds:
        place = folder / f"{kind}{seed}"
        place.mkdir()
        case = KINDS[kind](place, np.random.default_rng([seed, *kind.encode()]))
        ended = run(case.arguments, place)
        ends[ended.code] += 1
        slowest_s, most_bytes = max(slowest_s, ended.took_s), max(most_bytes, ended.peak_bytes)
        fault = ended.fault or (case.wrong_number() if ended.code == 0 else "")
        if fault:
            well = False
            print(f"  {kind} {seed}, {case.what}: {fault}\n    palpate {' '.join(case.arguments)}")
            print(f"    {ended.said.strip()[-300:]}", flush=True)
    codes = ", ".join(f"{number} ended with {code}" for code, number in sorted(ends.items()))
    print(
        f"{kind}: {len(seeds)} files; {codes}; at most {slowest_s:.1f} s, {most_bytes / 1e6:.0f} MB",
        flush=True,
    )
    return well


def main() -> None:
    """Try all, and exit with 1 if anything went wrong."""
    import palpate.app  # noqa: PLC0415, once for all children
    import palpate.commands.inspect  # noqa: F401, PLC0415

    first, _, last = (sys.argv[1] if len(sys.argv) > 1 else "100").rpartition("-")
    seeds = range(int(first or 0), int(last))
    with TemporaryDirectory() as folder:
        results = [fire(kind, seeds, Path(folder)) for kind in sys.argv[2:] or KINDS]
    sys.exit(not all(results))


if __name__ == "__main__":
    main()
