"""Interpreter and packages."""

import re
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from palpate import preflight
from palpate.doctor.finding import Finding, fail, ok, warn

CONSTRAINTS = Path(__file__).resolve().parents[2] / "constraints.txt"


def python() -> Iterator[Finding]:
    """CPython 3.11, in an environment of its own."""
    version = ".".join(str(part) for part in sys.version_info[:3])
    problem = preflight.python_problem((sys.version_info[0], sys.version_info[1]))
    if problem:
        yield fail("python", f"{version} in {sys.prefix}", problem)
    elif sys.prefix == sys.base_prefix:
        yield warn(
            "python", f"{version}, not in a virtual environment", "make env, then use .venv/bin/palpate"
        )
    else:
        yield ok("python", f"{version} in {sys.prefix}")


def control_package() -> Iterator[Finding]:
    """The name `control` belongs to palpate here."""
    problem = preflight.control_problem(preflight.find_control())
    if problem:
        yield fail("control package", "clashes with python-control", problem)
    elif _installed_version("control"):
        yield warn(
            "control package",
            "ours is found first, but python-control is installed too",
            "pip uninstall control",
        )
    else:
        yield ok("control package", "palpate's own")


def packages() -> Iterator[Finding]:
    """Every dependency is there, in the version that the project is tested with."""
    pinned = _pinned_versions()
    wanted = _dependencies()
    missing = [name for name in wanted if _installed_version(name) is None]
    other = [
        f"{name} {_installed_version(name)} (tested: {pinned[name]})"
        for name in wanted
        if name in pinned and _installed_version(name) not in (None, pinned[name])
    ]
    if missing:
        yield fail("packages", f"not installed: {', '.join(missing)}", "make clean env")
    if other:
        yield warn("packages", f"other versions than tested: {', '.join(other)}", "make clean env")
    if not missing and not other:
        yield ok("packages", f"all {len(wanted)} there" + (", in the tested versions" if pinned else ""))


def _dependencies() -> list[str]:
    required = metadata.requires("palpate") or []
    return [re.split(r"[^\w.-]", line)[0].lower() for line in required if "extra ==" not in line]


def _pinned_versions() -> dict[str, str]:
    """Versions by package; empty where palpate is installed without its source tree."""
    if not CONSTRAINTS.is_file():
        return {}
    pairs = (
        line.split("==") for line in CONSTRAINTS.read_text(encoding="utf-8").splitlines() if "==" in line
    )
    return {name.strip().lower(): version.strip() for name, version in pairs}


def _installed_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
