"""Change one place of the program at a time, and list the changes that the tests do not detect.

    python benchmarks/mutants.py [mutants, default 200] [--seed N] [--only session,guard,...] [--slow]

A mutant is one changed operator, number, condition or result, or one omitted statement, drawn evenly over
areas. The tests that name the changed module run first, then the others of its area, in a copy of the tree.
mutmut runs the whole suite first, and cosmic-ray needs one test command for all mutants: both would take days
here.
"""

import ast
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np
from harness import ROOT, arguments

AREAS = {  # folder of the program, and the test files in tests/ that should detect changes
    "guard": ("robot_io/guard", "robot_io/guard control/test_loop_failures.py"),
    "loop": ("control/loop", "control/test_loop*.py control/test_timing.py control/test_realtime.py"),
    "session": ("robot_io/session", "robot_io/test_session_*.py"),
    "drivers": (
        "robot_io/drivers",
        "robot_io/drivers robot_io/can robot_io/serial_force robot_io/test_request_queue.py wire "
        "fuzz/test_fuzz_codecs.py",
    ),
    "fit": (
        "estimation/fit",
        "estimation/fit estimation/study estimation/diagnosis estimation/test_robust.py "
        "estimation/test_contact_estimators.py",
    ),
    "diagnosis": (
        "estimation/diagnosis",
        "estimation/diagnosis estimation/design estimation/arm/test_channels.py",
    ),
    "workbench": ("palpate/workbench", "palpate/workbench"),
    "sweep": ("palpate/sweep", "palpate/sweep palpate/test_ended_from_outside.py"),
}
GOAL = 0.97
MOST_S = 900.0  # that the tests of an area may take without a mutant
# Tests that take longer than this multiple of their usual time, plus this margin, never end.
LONGER, MARGIN_S = 2.5, 60.0
_LOOKS = {"alpha", "figsize", "fontsize", "lw", "mew", "ms", "rotation"}
_COMPARED = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
_COMPARED |= {ast.In: "not in", ast.NotIn: "in", ast.Is: "is not", ast.IsNot: "is"}
_COMPUTED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/"} | dict.fromkeys(
    (ast.Div, ast.FloorDiv, ast.Pow, ast.Mod), "*"
)


@dataclass(frozen=True)
class Mutant:
    """One change: the file, the replaced characters, and the new text."""

    area: str
    file: Path
    line: int
    start: int
    end: int
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {' '.join(self.old.split())} -> {' '.join(self.new.split())}"


def mutants_of(area: str, file: Path) -> list[Mutant]:
    """List all mutants of a file, whose path is relative to the root."""
    source = (ROOT / file).read_text(encoding="utf-8")
    begins = [0, *accumulate(map(len, source.encode().splitlines(keepends=True)))]
    mutants = []
    for node, new in _changes(ast.parse(source)):
        start = begins[node.lineno - 1] + node.col_offset
        end = begins[node.end_lineno - 1] + node.end_col_offset
        old = source.encode()[start:end].decode()
        mutants.append(Mutant(area, file, node.lineno, start, end, old, new))
    return mutants


def _changes(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Yield nodes with the text that replaces them in a mutant.

    Changes that no test of a correct program can detect are omitted: types and what guards them (`frozen`,
    `slots` and other decorators), texts, imports, line widths and other styles of a drawing, and `strict` of
    a zip, which is an assertion.
    """
    for node in ast.iter_child_nodes(tree):
        types = (getattr(tree, "annotation", None), getattr(tree, "returns", None))
        is_zip = isinstance(node, ast.keyword) and ast.unparse(getattr(tree, "func", tree)) == "zip"
        name = getattr(node, "arg", None)  # of a keyword
        if isinstance(tree, ast.Dict) and node in tree.values:
            name = getattr(tree.keys[tree.values.index(node)], "value", None)
        if node in types or node in getattr(tree, "decorator_list", ()) or is_zip or name in _LOOKS:
            continue
        if isinstance(tree, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            continue
        if new := _changed(node):
            yield node, new
        yield from _changes(node)


def _changed(node: ast.AST) -> str:
    """Return the changed text of one node; empty if there is none."""
    text = ast.unparse
    match node:
        case ast.Compare(left, [operator], [right]):
            return f"({text(left)} {_COMPARED[type(operator)]} {text(right)})"
        case ast.BoolOp(operator, values):
            changed = " or " if isinstance(operator, ast.And) else " and "
            return f"({changed.join(f'({text(value)})' for value in values)})"
        case ast.BinOp(left, operator, right) if type(operator) in _COMPUTED:
            return f"(({text(left)}) {_COMPUTED[type(operator)]} ({text(right)}))"
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            return f"({text(operand)})"
        case ast.Constant(bool() as value):
            return str(not value)
        case ast.Constant(int() | float() as value) if not 0.0 < value < 1e-8:  # a tolerance for rounding
            return str(value + 1 if isinstance(value, int) else 2.0 * value or 1.0)
        case ast.IfExp(test, body, changed):
            return f"({text(changed)} if {text(test)} else {text(body)})"
        case ast.Return(value) if value is not None and not isinstance(value, ast.Constant):
            return "return None"
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Raise():
            return "pass"
    return ""


def sampled(count: int, areas: list[str], seed: int) -> list[Mutant]:
    """Draw equally many mutants of each area at random, without repetition."""
    random, drawn = Random(seed), list[Mutant]()
    for number, area in enumerate(areas):
        files = sorted(path.relative_to(ROOT) for path in (ROOT / AREAS[area][0]).rglob("*.py"))
        every = [mutant for file in files for mutant in mutants_of(area, file)]
        drawn += random.sample(every, count // len(areas) + (number < count % len(areas)))
    random.shuffle(drawn)
    return drawn


class Trial:
    """A copy of the tree in which one mutant at a time is tested.

    Args:
        tree: the copy.
        slow: whether the slow tests run too; those of the workbench need a browser.
    """

    def __init__(self, tree: Path, *, slow: bool) -> None:
        self._tree = tree
        self._marks = ["-m", ""] if slow else []
        self._most_s = dict.fromkeys(AREAS, MOST_S)
        listed = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True)
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file() or (ROOT / name).is_symlink():
                (tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(ROOT / name, tree / name, follow_symlinks=False)

    def check(self, area: str) -> None:
        """Exit if the tests fail twice without a mutant, because they could not detect one."""
        started, tests = time.perf_counter(), [str(path) for path in self._files(area)]
        if self._failing(area, tests) and (by := self._failing(area, tests)):
            raise SystemExit(f"{area}: the tests fail as it is: {by}")
        self._most_s[area] = LONGER * (time.perf_counter() - started) + MARGIN_S

    def noticed_by(self, mutant: Mutant) -> str:
        """Return the test that detected a mutant, or "no end" if the tests did not end; empty if none did."""
        whole = (self._tree / mutant.file).read_bytes()
        (self._tree / mutant.file).write_bytes(
            whole[: mutant.start] + mutant.new.encode() + whole[mutant.end :]
        )
        try:
            near, far = self._tests(mutant)
            return self._failing(mutant.area, near) or self._failing(mutant.area, far)
        finally:
            (self._tree / mutant.file).write_bytes(whole)

    def _tests(self, mutant: Mutant) -> tuple[list[str], list[str]]:
        """Return the test files that name the module or its folder, and the others of the area."""
        files = self._files(mutant.area)
        parts = mutant.file.with_suffix("").parts  # the program's own folder has the package's name already
        module = ".".join(parts if parts[0] == "palpate" else ("palpate", *parts))
        names = (module, f"{module.rpartition('.')[0]} import", f"import {mutant.file.stem}")
        near = [path for path in files if any(name in path.read_text(encoding="utf-8") for name in names)]
        near.sort(key=lambda path: module not in path.read_text(encoding="utf-8"))
        return [str(path) for path in near], [str(path) for path in files if path not in near]

    def _files(self, area: str) -> list[Path]:
        places = (place for name in AREAS[area][1].split() for place in (self._tree / "tests").glob(name))
        return sorted(
            path for place in places for path in ([place] if place.is_file() else place.rglob("test_*.py"))
        )

    def _failing(self, area: str, tests: list[str]) -> str:
        if not tests:
            return ""
        options = ["-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", "-n", "0"]
        command = [sys.executable, *options, *self._marks, *tests]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        environment["PYTHONPATH"] = str(self._tree)
        where = {"cwd": self._tree, "env": environment, "start_new_session": True, "text": True}
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **where) as process:
            try:
                said, _ = process.communicate(timeout=self._most_s[area])
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                return "no end"
        if process.returncode == 0:
            return ""
        failed = [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return (failed or said.splitlines()[-1:] or ["no end"])[0][:150]


def main() -> None:
    """Test the mutants, print a line for each and the share detected; exit with 1 below the goal."""
    options = arguments(__doc__)
    options.add_argument("count", nargs="?", type=int, default=200)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--slow", action="store_true")
    options.add_argument("--only", default=",".join(AREAS))
    given = options.parse_args()
    noticed: dict[str, list[bool]] = defaultdict(list)
    drawn = sampled(given.count, given.only.split(","), given.seed)  # of the same files as in the copy
    with TemporaryDirectory() as folder:
        trial = Trial(Path(folder), slow=given.slow)
        for area in given.only.split(","):
            trial.check(area)
        for mutant in drawn:
            started = time.perf_counter()
            by = trial.noticed_by(mutant)
            noticed[mutant.area].append(bool(by))
            word, took_s = "noticed" if by else "MISSED ", time.perf_counter() - started
            print(f"{word} {took_s:5.0f} s  {mutant}  {by}", flush=True)
    for area, results in noticed.items():
        print(f"{area}: {sum(results)} of {len(results)}")
    every = [result for results in noticed.values() for result in results]
    print(f"noticed: {sum(every)} of {len(every)}, {100 * np.mean(every):.0f} % (goal {100 * GOAL:.0f} %)")
    sys.exit(sum(every) < GOAL * len(every))


if __name__ == "__main__":
    main()
