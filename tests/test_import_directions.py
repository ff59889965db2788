"""The house: imports run one way, and the simulator's physics never meets the estimator's hypotheses."""

import ast
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
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module)
    return {name.split(".")[0] for name in names} & set(ALLOWED)


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_package_imports_only_what_the_house_allows(package):
    wrong = {
        f"{path.relative_to(ROOT)} imports {other}"
        for path in (ROOT / package).rglob("*.py")
        for other in imported_packages(path) - ALLOWED[package] - {package}
    }
    assert not wrong


def test_the_check_sees_a_forbidden_import(tmp_path):
    path = tmp_path / "bad.py"
    path.write_text("def f():\n    from estimation.effects import stiffness\n")
    assert imported_packages(path) - ALLOWED["sim_backend"] == {"estimation"}
