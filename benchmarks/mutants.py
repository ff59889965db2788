"""Change one place of the program at a time, and list the changes that the tests do not detect.

    python benchmarks/mutants.py [mutants, default 200] [--seed N] [--only robot_io/guard,...]

A mutant is one changed operator, number, condition or result, or one omitted statement, drawn evenly over
areas. The tests of its area run in a copy of git's index, those first that name the changed module. mutmut
runs the whole suite first, and cosmic-ray needs one test command for all mutants: both would take days here.
"""

import ast
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from harness import ROOT, arguments

AREAS = {  # by folder of the program: the tests that should detect changes
    "robot_io/guard": "robot_io/guard control/test_loop_failures.py",
    "control/loop": "control/test_loop*.py control/test_timing.py control/test_realtime.py",
    "robot_io/session": "robot_io/test_session_*.py",
    "robot_io/drivers": "robot_io/drivers robot_io/can robot_io/serial_force robot_io/test_request_queue.py "
    "wire fuzz/test_fuzz_codecs.py",
    "estimation/fit": "estimation/fit estimation/study estimation/diagnosis estimation/test_robust.py",
    "estimation/diagnosis": "estimation/diagnosis estimation/design estimation/arm/test_channels.py",
    "palpate/workbench": "palpate/workbench",
    "palpate/sweep": "palpate/sweep palpate/test_ended_from_outside.py",
}
GOAL = 0.97
# Tests that take longer than this multiple of their usual time, plus this margin, never end.
LONGER, MARGIN_S = 2.5, 60.0
_COMPARED = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "=="}
_COMPARED |= {ast.In: "not in", ast.NotIn: "in", ast.Is: "is not", ast.IsNot: "is"}
_COMPUTED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/"} | dict.fromkeys(
    (ast.Div, ast.FloorDiv, ast.Pow, ast.Mod), "*"
)


def mutated(source: bytes, node: ast.AST, new: str) -> bytes:
    """Return the source with a node replaced."""
    begins = [0, *accumulate(map(len, source.splitlines(keepends=True)))]
    start, end = begins[node.lineno - 1] + node.col_offset, begins[node.end_lineno - 1] + node.end_col_offset
    return source[:start] + new.encode() + source[end:]


def changes(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Yield nodes with the text that replaces them in a mutant.

    Changes that no test of a correct program can detect are omitted: types and what guards them (`frozen`,
    `slots` and other decorators), texts, imports, and `strict` of a zip, which is an assertion.
    """
    for node in ast.iter_child_nodes(tree):
        types = (getattr(tree, "annotation", None), getattr(tree, "returns", None))
        is_zip = isinstance(node, ast.keyword) and ast.unparse(getattr(tree, "func", tree)) == "zip"
        if node in types or node in getattr(tree, "decorator_list", ()) or is_zip:
            continue
        if isinstance(tree, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            continue
        if new := _changed(node):
            yield node, new
        yield from changes(node)


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


def tests_of(tree: Path, area: str, file: Path) -> list[str]:
    """Return the test files of an area; those that name the module of `file` come first."""
    places = [place for name in AREAS[area].split() for place in (tree / "tests").glob(name)]
    tests = {path for place in places for path in [place, *place.rglob("test_*.py")] if path.is_file()}
    parts = file.relative_to(tree).with_suffix("").parts
    module = ".".join(parts if parts[0] == "palpate" else ("palpate", *parts))
    return sorted(map(str, tests), key=lambda path: (module not in Path(path).read_text("utf-8"), path))


def failing_test(tree: Path, tests: Sequence[str], most_s: float | None = None) -> str:
    """Return the test that fails first, or "no end" if the tests take too long; empty if none fails."""
    options = ["-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", "-n", "0"]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONPATH"] = str(tree)
    command = {"args": [sys.executable, *options, *tests], "cwd": tree, "env": environment}
    try:
        ended = subprocess.run(**command, capture_output=True, text=True, timeout=most_s, check=False)
    except subprocess.TimeoutExpired:
        return "no end"
    failed = [line for line in ended.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return (failed or ["no summary"])[0][:150] if ended.returncode else ""


def main() -> None:
    """Test the mutants, print a line for each and the share detected; exit with 1 below the goal."""
    parser = arguments(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default=",".join(AREAS))
    options = parser.parse_args()
    random, areas, drawn, most_s = Random(options.seed), options.only.split(","), [], {}
    noticed: dict[str, list[bool]] = defaultdict(list)
    with TemporaryDirectory() as folder:
        tree = Path(folder).resolve()
        subprocess.run(["git", "checkout-index", "--all", f"--prefix={tree}/"], cwd=ROOT, check=True)
        for area in areas:
            files = sorted((tree / area).rglob("*.py"))
            every = [
                (area, file, *change) for file in files for change in changes(ast.parse(file.read_bytes()))
            ]
            drawn += random.sample(every, options.count // len(areas))
            started = time.perf_counter()
            if failed := failing_test(tree, tests_of(tree, area, files[0])):
                raise SystemExit(f"{area}: the tests fail as it is: {failed}")
            most_s[area] = LONGER * (time.perf_counter() - started) + MARGIN_S
        for area, file, node, new in random.sample(drawn, len(drawn)):
            source = file.read_bytes()
            file.write_bytes(mutated(source, node, new))
            by = failing_test(tree, tests_of(tree, area, file), most_s[area])
            file.write_bytes(source)
            noticed[area].append(bool(by))
            change = f"{file.relative_to(tree)}:{node.lineno}: {ast.unparse(node)} -> {new}"
            print("noticed" if by else "MISSED ", " ".join(change.split()), by, flush=True)
    for area, results in noticed.items():
        print(f"{area}: {sum(results)} of {len(results)}")
    share = sum(map(sum, noticed.values())) / len(drawn)
    print(f"noticed: {100 * share:.0f} % of {len(drawn)} (goal {100 * GOAL:.0f} %)")
    sys.exit(share < GOAL)


if __name__ == "__main__":
    main()
