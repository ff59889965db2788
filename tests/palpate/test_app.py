"""The command line itself: help, unknown names, failures, completion, JSON of errors, exit codes."""

import json
import os
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from palpate import main
from palpate.commands import COMMANDS, app, load_command
from palpate.commands.diagnose import _exit_code_of
from palpate.common import preflight
from palpate.common.failures import OneLineGroup
from palpate.estimation.diagnosis import Verdict
from palpate.estimation.effects import EFFECTS
from palpate.robot_io.errors import DeviceError, InputError, UnloggedError
from tests.palpate.cli import ROOT, assert_refused, done, run, run_process

# Python 3.11 wraps whatever `__set_name__` raises, as in the imports of a command, in a RuntimeError.
CLASS_INTERRUPTED = RuntimeError("Error calling __set_name__ on 'Field' instance '_cache' in 'Search'")
CLASS_INTERRUPTED.__cause__ = KeyboardInterrupt()


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
    assert "Usage" in done(command, "--help").stdout
    loaded = load_command(command)
    texts = [each.help for each in (loaded, *getattr(loaded, "commands", {}).values())]
    paragraphs = [paragraph for text in texts for paragraph in text.split("\n\n")]
    lines = [line for paragraph in paragraphs for line in paragraph.split("\n")[1:]]
    assert all(line.startswith("  palpate ") for line in lines)  # the terminal breaks all lines but examples


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("value 3 is wrong"), 2, ("value 3 is wrong",)),
        (InputError("spread\nover\nlines"), 2, ("spread over lines",)),
        (DeviceError("the cable is out"), 1, ("the cable is out",)),
        (UnloggedError("the writer ended with -9"), 1, ("the writer ended with -9",)),
        (PermissionError(13, "Permission denied", "/some/file"), 2, ("/some/file", "Permission denied")),
        (ImportError("libgomp.so.1: cannot open object"), 1, ("libgomp.so.1", "apt install libgomp1")),
        (ImportError("cannot import name 'x'"), 1, ("internal error", "cannot import name")),
        (ZeroDivisionError("a bug"), 1, ("ZeroDivisionError", "a bug", "PALPATE_DEBUG")),
        (KeyboardInterrupt(), 130, ("interrupted",)),
        (CLASS_INTERRUPTED, 130, ("interrupted",)),
    ],
)
def test_failure_is_one_line_with_its_own_exit_code(error, code, words):
    assert_refused(CliRunner().invoke(app_that_raises(error), ["fail"]), *words, code=code)


def test_version_option_prints_the_version():
    assert done("--version").stdout.startswith("palpate ")


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
        (0, "warnings.warn('overflow in square', RuntimeWarning)", 0),
    ],
)
def test_late_failures_and_warnings_do_not_change_the_outcome(code, end, expected):
    program = (
        "import atexit, os, signal, sys, warnings\n"
        "from palpate import main\n"
        f"atexit.register(lambda: {end})\n"
        f"main.run = lambda: sys.exit({code})\n"
        "main.main()\n"
    )
    result = run_process(code=program)
    assert (result.returncode, result.stderr) == (expected, "")


def test_closed_output_pipe_is_no_error():
    starter = "import sys; sys.stdout = sys.stderr = None; from palpate.main import main; main()"
    command = [sys.executable, "-c", starter, "effects", "backlash"]  # as Python has it after >&- 2>&-
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("palpate dia", {"diagnose"}),
        ("palpate diagnose --exit", {"--exit-code"}),
        ("palpate calibrate enc", {"encoder"}),
        ("palpate effects cubic", {"cubic_stiffness"}),
        ("palpate add x.csv stri", {"stribeck_friction"}),
        ("palpate remove x.csv ", set(EFFECTS)),
        ("palpate probe --scenario s", {"soft", "stiff"}),
        ("palpate demo --scenario hunt", {"hunt_crossley"}),
        ("palpate teleop demo --scenario pa", {"paper"}),
        ("palpate probe --hidden back", {"backlash"}),
        ("palpate probe --robot le", {"leader"}),
        ("palpate estimate x.csv --model kel", {"kelvin_voigt"}),
        ("palpate compare x.csv --other-model hunt", {"hunt_crossley"}),
        ("palpate estimate x.csv --estimator rans", {"ransac"}),
    ],
)
def test_shell_completes_commands_options_and_their_values(typed, offered, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # files are offered, too
    result = CliRunner().invoke(app, prog_name="palpate", env=asked_by_bash(typed))
    assert set(result.stdout.split()) == offered, result.stderr


def asked_by_bash(typed):
    last = str(len(typed.split(" ")) - 1)
    return {"_PALPATE_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": last}


def test_program_itself_completes():
    code = "import sys; sys.argv = ['palpate']; from palpate.main import main; main()"
    said = run_process(code=code, env=os.environ | asked_by_bash("palpate effects cubic"))
    assert said.stdout.split() == ["cubic_stiffness"], said.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("info", "none.mcap"), ("none.mcap: no such file",)),
        (("compare", "none\x1b[2J\n.csv"), ("no such file",)),
        (("diagnose", "none.csv", "--colour"), ("No such option: --colour", "palpate diagnose --help")),
        (("info",), ("session", "palpate info --help")),
        (("estimat",), ("estimat", "estimate")),
    ],
)
def test_bad_input_is_refused_with_help_also_as_json(arguments, words):
    plain, result = run(*arguments), run(*arguments, "--json")
    assert_refused(plain, *words)
    assert plain.stdout == ""
    assert plain.stderr.rstrip("\n").isprintable()
    (line,) = result.stdout.splitlines()
    told = json.loads(line)
    assert all(word in told["error"] for word in words)
    assert told["exit_code"] == result.exit_code == 2
    assert line.isprintable()
    assert result.stderr == f"palpate: {told['error']}\n"


@pytest.mark.parametrize(
    ("verdicts", "code"),
    [
        (("adequate",), 0),
        (("adequate", "missing"), 10),
        (("insufficient", "unexplained"), 11),
        (("adequate", "insufficient"), 12),
        (("unexplained", "missing", "insufficient"), 10),
    ],
)
def test_exit_code_of_a_diagnosis_is_that_of_its_worst_verdict(verdicts, code):
    assert _exit_code_of([Verdict(one) for one in verdicts]) == code


def test_exit_code_tells_the_verdict_on_request(few_effects, hardening):
    """Without the option it is 0: tests/palpate/test_diagnose.py, and with --json test_docs.py."""
    asked = run("diagnose", hardening, "--json", "--exit-code")
    assert json.loads(asked.stdout)["channels"][0]["verdict"] == "missing"
    assert asked.exit_code == 10


COLOURS = [f"\x1b[{first}{second}" for first in "349" for second in "01234567"]


@pytest.mark.parametrize("command", [("effects", "lag"), ("info", "none.mcap")])
def test_no_color_is_respected(command, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    shown = run(*command)
    monkeypatch.setenv("NO_COLOR", "1")
    told = run(*command)
    assert (command[0] == "info") or [one for one in COLOURS if one in shown.stdout + shown.stderr]
    assert not [one for one in COLOURS if one in told.stdout + told.stderr]


def test_no_color_is_respected_at_import():
    told = run_process("info", "--help", env=os.environ | {"NO_COLOR": "1", "FORCE_COLOR": "1"})
    assert not [one for one in COLOURS if one in told.stdout]
