"""Imports run in one direction, and simulator and estimator are independent."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "robot_io": set(),
    "control": {"robot_io"},
    "estimation": {"robot_io", "control"},
    "calibration": {"robot_io", "control", "estimation"},
    "sim_backend": {"robot_io"},
    "palpate": {"robot_io", "control", "estimation", "calibration", "sim_backend"},
}


def imported_packages(path: Path) -> set[str]:
    """By folder: `palpate.control.loop` is of `control`, all else in palpate of `palpate`."""
    parts = [name.split(".") for name in imported_modules(path)]
    return {
        name[1] if name[1:2] and name[1] in ALLOWED else name[0] for name in parts if name[0] == "palpate"
    }


@cache
def imported_modules(path: Path) -> frozenset[str]:
    names: set[str] = set()
    for node in statements(ast.parse(path.read_text(encoding="utf-8")).body):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def statements(body: list[ast.AST]) -> Iterator[ast.AST]:
    """Iterate over all statements, also nested ones; `ast.walk` would also visit every expression."""
    for node in body:
        yield node
        for part in ("body", "handlers", "orelse", "finalbody", "cases"):
            inner = getattr(node, part, None)
            yield from statements(inner) if isinstance(inner, list) else ()


def rooms(folder: Path) -> dict[str, set[str]]:
    """For each file or folder in a folder, the others there that it imports; `__init__` only hands on."""
    place = ".".join(folder.relative_to(ROOT).parts) + "."
    if folder.relative_to(ROOT).parts[0] in ALLOWED.keys() - {"palpate"}:
        place = f"palpate.{place}"
    uses: dict[str, set[str]] = {}
    for path in folder.rglob("*.py"):
        room = path.relative_to(folder).parts[0].removesuffix(".py")
        inside = {name.removeprefix(place) for name in imported_modules(path) if name.startswith(place)}
        uses.setdefault(room, set()).update(name.split(".")[0] for name in inside)
    uses.pop("__init__", None)
    return {room: others - {room} for room, others in uses.items()}


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_package_imports_only_allowed_packages(package):
    wrong = {
        f"{path.relative_to(ROOT)} imports {other}"
        for path in (ROOT / package).rglob("*.py")
        for other in imported_packages(path) - ALLOWED[package] - {package}
    }
    assert not wrong


FOLDERS = sorted({path.parent for package in ALLOWED for path in (ROOT / package).rglob("*.py")})


def test_no_package_imports_itself_in_a_circle():
    for folder in FOLDERS:
        TopologicalSorter(rooms(folder)).prepare()  # raises CycleError with the way round


def test_every_import_is_under_the_one_name():
    """In a checkout `control` can be imported as well, a second time, beside `palpate.control`."""
    folders = [path for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")]
    beside = ALLOWED.keys() - {"palpate"}
    named = re.compile(rf"\b({'|'.join(beside)})\b")  # parsing takes longer than this search
    files = [path for folder in folders for path in folder.rglob("*.py")]
    files = [path for path in files if named.search(path.read_text(encoding="utf-8"))]
    assert not [path for path in files for name in imported_modules(path) if name.split(".")[0] in beside]
