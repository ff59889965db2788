"""The command line itself: help, unknown things, failures of every kind."""

import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from palpate import main
from palpate.commands import load_command
from palpate.common import preflight
from palpate.common.failures import OneLineGroup
from palpate.robot_io.errors import DeviceError, InputError
from tests.palpate.cli import ROOT, assert_refused, done, run, run_process

COMMANDS = (
    *("demo", "probe", "estimate", "inspect", "compare", "diagnose", "add", "revisions", "export", "reveal"),
    *("import", "info", "sweep", "doctor", "effects", "replay", "merge"),
)


def app_that_raises(error):
    app = typer.Typer(cls=OneLineGroup, pretty_exceptions_enable=False)

    @app.callback()
    def root():
        """Root."""

    @app.command()
    def fail():
        raise error

    return app


def test_without_a_command_the_help_is_shown():
    result = done()
    for command in COMMANDS:
        assert command in result.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command):
    result = done(command, "--help")
    assert "Usage" in result.stdout
    paragraphs = load_command(command).help.split("\n\n")
    assert not any("\n" in paragraph for paragraph in paragraphs)  # the terminal breaks lines, nobody else


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("estimat",), ("estimat", "estimate")),
        (("info", "--colour"), ("--colour", "palpate info --help")),
        (("info",), ("session", "palpate info --help")),
    ],
)
def test_what_is_unknown_or_missing_is_refused_with_what_helps(arguments, words):
    assert_refused(run(*arguments), *words)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("value 3 is wrong"), 2, ("value 3 is wrong",)),
        (InputError("spread\nover\nlines"), 2, ("spread over lines",)),
        (DeviceError("the cable is out"), 1, ("the cable is out",)),
        (PermissionError(13, "Permission denied", "/some/file"), 2, ("/some/file", "Permission denied")),
        (
            ImportError("libgomp.so.1: cannot open shared object file"),
            1,
            ("libgomp.so.1", "apt install libgomp1"),
        ),
        (ImportError("cannot import name 'x'"), 1, ("internal error", "cannot import name")),
        (ZeroDivisionError("a bug"), 1, ("ZeroDivisionError", "a bug", "PALPATE_DEBUG")),
        (KeyboardInterrupt(), 130, ("interrupted",)),
    ],
)
def test_a_failure_is_one_line_with_its_own_exit_code(error, code, words):
    result = CliRunner().invoke(app_that_raises(error), ["fail"])
    assert_refused(result, *words, code=code)


def test_ctrl_c_while_a_class_is_made_is_no_internal_error():
    """Python 3.11 wraps whatever `__set_name__` raises, as in the imports of a command, in a RuntimeError."""
    error = RuntimeError("Error calling __set_name__ on 'Field' instance '_cache' in 'Search'")
    error.__cause__ = KeyboardInterrupt()
    assert_refused(CliRunner().invoke(app_that_raises(error), ["fail"]), "interrupted", code=130)


def test_as_a_process_bad_input_gives_one_line_and_2(tmp_path):
    assert_refused(run_process("info", tmp_path / "none.mcap"), "none.mcap", "no such file")


def test_the_version_is_told():
    result = done("--version")
    assert result.stdout.startswith("palpate ")


def test_ctrl_c_while_commands_are_loaded_leaves_no_traceback(monkeypatch, capsys):
    def pressed():
        raise KeyboardInterrupt

    monkeypatch.setattr(preflight, "first_problem", pressed)
    with pytest.raises(SystemExit) as ended:
        main.run()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "palpate: interrupted\n"


@pytest.mark.parametrize(
    ("code", "end", "expected"),
    [
        (130, "os.abort()", 130),  # a library's thread that was interrupted may do so
        (0, "os.kill(os.getpid(), signal.SIGINT)", 0),  # an impatient Ctrl-C when all is done
        (2, "print('tidied up')", 2),
    ],
)
def test_nothing_that_happens_at_the_very_end_changes_how_it_ended(code, end, expected):
    program = (
        "import atexit, os, signal, sys\n"
        "from palpate import main\n"
        f"atexit.register(lambda: {end})\n"
        f"main.run = lambda: sys.exit({code})\n"
        "main.main()\n"
    )
    result = run_process(code=program)
    assert (result.returncode, result.stderr) == (expected, "")


def test_output_that_nobody_takes_is_no_error():
    starter = "import sys; sys.stdout = sys.stderr = None; from palpate.main import main; main()"
    command = [sys.executable, "-c", starter, "effects", "backlash"]  # as Python has it after >&- 2>&-
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def test_what_libraries_mutter_is_not_heard():
    program = (
        "import sys, warnings\n"
        "from palpate import main\n"
        "def mutter():\n"
        "    warnings.warn('overflow in square', RuntimeWarning)\n"
        "    sys.exit(0)\n"
        "main.run = mutter\n"
        "main.main()\n"
    )
    result = run_process(code=program)
    assert (result.returncode, result.stderr) == (0, "")
