"""Before anything else: the right Python, and a package `control` that is ours."""

import subprocess
import sys
from pathlib import Path

import control
from palpate.common import preflight
from tests.palpate.cli import ROOT, assert_refused

OURS = control.__file__


def test_what_is_wrong_with_python_and_control_is_said(tmp_path):
    for version in ((3, 11), (3, 13), (3, 14)):
        assert preflight.python_problem(version) is None
    assert "needs CPython 3.11 or newer, this is 3.10" in preflight.python_problem((3, 10))
    assert preflight.control_problem(OURS) is None
    assert "missing" in preflight.control_problem(None)
    theirs = tmp_path / "site-packages" / "control" / "__init__.py"
    problem = preflight.control_problem(str(theirs))
    assert str(theirs.parent) in problem
    assert "pip uninstall control" in problem


def test_a_folder_that_was_deleted_meanwhile_is_said(tmp_path, monkeypatch):
    assert preflight.folder_problem() is None
    monkeypatch.chdir(tmp_path)
    tmp_path.rmdir()
    assert "change to another one" in preflight.first_problem()


def test_the_command_stops_when_another_control_comes_first(tmp_path):
    (tmp_path / "control").mkdir()
    (tmp_path / "control" / "__init__.py").write_text("__version__ = '0.10.1'\n")
    # As a user's PYTHONPATH would: another folder before ours.
    path = [str(tmp_path), str(ROOT)]
    starter = f"import sys; sys.path[:0] = {path}; from palpate.main import main; main()"
    result = subprocess.run(
        [sys.executable, "-c", starter], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert_refused(result, "control", str(tmp_path))


def test_the_checks_need_nothing_but_the_standard_library():
    source = Path(preflight.__file__)
    program = (
        f"import runpy; print(sorted(runpy.run_path({str(source)!r})['first_problem'].__code__.co_names))"
    )
    result = subprocess.run(
        [sys.executable, "-S", "-I", "-c", program], capture_output=True, text=True, check=False, cwd="/"
    )
    assert result.returncode == 0, result.stderr
