"""Commands in a foreign folder execute none of its Python files."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from palpate.common import preflight
from palpate.teleop.demo import script
from tests.free_port import free_port
from tests.palpate.cli import ROOT
from tests.palpate.planted import install_program, planted_modules
from tests.palpate.presses import write_presses

GRID = """
objects: [{name: kelvin_voigt, stiffness_n_m: 500, damping_n_s_m: 10}]
speeds_mm_s: [[150]]
noise_std_n: [0.02]
repeats: 1
estimators: [lsq]
"""


@pytest.fixture
def planted(tmp_path):
    """A folder with a recording and, beside it, files named like modules."""
    folder, mark = tmp_path / "theirs", tmp_path / "executed"
    folder.mkdir()
    (folder / "matplotlibrc").write_text("text.usetex: True\n")
    (folder / "grid.yaml").write_text(GRID)
    (folder / "operator.yaml").write_text(yaml.safe_dump(script(0.05, last_s=1.0)))
    write_presses(folder / "press.csv")
    with planted_modules(folder, mark):
        yield folder


@pytest.fixture
def installed(tmp_path):
    return install_program(tmp_path)


def run_in(folder: Path, program: Path, *arguments) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return subprocess.run(
        [sys.executable, str(program), *map(str, arguments)],
        cwd=folder, env=environment | {"PYTHONPATH": str(ROOT)}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [  # the leader, below, also starts the process that writes a session
        ("doctor", "--wire", "--robot", str(ROOT / "robots" / "dynamixel_3dof.yaml")),
        ("sweep", "grid.yaml", "--workers", "1", "--out", "swept"),
        pytest.param(("diagnose", "press.csv"), marks=pytest.mark.slow),
    ],
)
def test_no_planted_file_runs(planted, installed, arguments):
    done = run_in(planted, installed, *arguments)
    assert done.returncode == 0, done.stderr


def test_no_planted_file_runs_in_the_leaders_haptic_process(planted, installed):
    port = ("--port", free_port(), "--operator", "operator.yaml", "-o", "leader.mcap")
    done = run_in(planted, installed, "teleop", "leader", *port)
    assert done.returncode == 1, done.stderr  # no follower was heard
    assert "palpate teleop follower --help" in done.stderr


@pytest.mark.slow
def test_no_planted_file_runs_in_both_sides_of_the_demo(planted, installed):
    done = run_in(planted, installed, "teleop", "demo", "--out", "demo")
    assert done.returncode == 0, done.stderr
    shutil.rmtree(planted / "demo")


def test_python_problem_is_reported():
    for version in ((3, 11), (3, 13), (3, 14)):
        assert preflight.python_problem(version) is None
    assert "needs CPython 3.11 or newer, but this is 3.10" in preflight.python_problem((3, 10))


def test_folder_deleted_during_a_run_is_reported(tmp_path, monkeypatch):
    assert preflight.folder_problem() is None
    monkeypatch.chdir(tmp_path)
    tmp_path.rmdir()
    assert "change to another one" in preflight.first_problem()


def test_checks_need_only_the_standard_library():
    source = Path(preflight.__file__)
    program = (
        f"import runpy; print(sorted(runpy.run_path({str(source)!r})['first_problem'].__code__.co_names))"
    )
    result = subprocess.run(
        [sys.executable, "-S", "-I", "-c", program], capture_output=True, text=True, check=False, cwd="/"
    )
    assert result.returncode == 0, result.stderr
