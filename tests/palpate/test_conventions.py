"""What people expect of a command line: completion, JSON of errors, exit codes, widths, no colours."""

import json
import os
import tomllib

import pytest
from typer.testing import CliRunner

from palpate.commands import app
from palpate.commands.diagnose import exit_code_of
from palpate.estimation.diagnosis import Verdict
from palpate.estimation.effects import EFFECTS
from tests.palpate.cli import ROOT, run, run_process


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
def test_a_shell_completes_commands_options_and_their_values(typed, offered):
    result = CliRunner().invoke(app, prog_name="palpate", env=asked_by_bash(typed))
    assert set(result.stdout.split()) == offered, result.stderr


def asked_by_bash(typed):
    last = str(len(typed.split(" ")) - 1)
    return {"_PALPATE_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": last}


def test_the_program_itself_completes():
    code = "import sys; sys.argv = ['palpate']; from palpate.main import main; main()"
    said = run_process(code=code, env=os.environ | asked_by_bash("palpate effects cubic"))
    assert said.stdout.split() == ["cubic_stiffness"], said.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("info", "none.mcap"), "none.mcap: no such file"),
        (("compare", "none\x1b[2J\n.csv"), "no such file"),
        (("diagnose", "none.csv", "--colour"), "No such option: --colour"),
        (("estimat",), "estimat"),
    ],
)
def test_with_json_an_error_is_one_line_of_json_too(arguments, words):
    plain, result = run(*arguments), run(*arguments, "--json")
    assert plain.stdout == ""
    (line,) = result.stdout.splitlines()
    told = json.loads(line)
    assert words in told["error"]
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
def test_the_exit_code_of_a_diagnosis_is_that_of_its_worst_verdict(verdicts, code):
    assert exit_code_of([Verdict(one) for one in verdicts]) == code


def test_the_exit_code_tells_the_verdict_where_that_was_asked(few_effects, hardening):
    """Without the option it is 0: tests/palpate/test_diagnose.py, and with --json test_docs.py."""
    asked = run("diagnose", hardening, "--json", "--exit-code")
    assert json.loads(asked.stdout)["channels"][0]["verdict"] == "missing"
    assert asked.exit_code == 10


COLOURS = [f"\x1b[{first}{second}" for first in "349" for second in "01234567"]


@pytest.mark.parametrize("command", [("effects", "lag"), ("info", "none.mcap")])
def test_no_color_is_heeded(command, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    shown = run(*command)
    monkeypatch.setenv("NO_COLOR", "1")
    told = run(*command)
    assert (command[0] == "info") or [one for one in COLOURS if one in shown.stdout + shown.stderr]
    assert not [one for one in COLOURS if one in told.stdout + told.stderr]


def test_no_color_is_heeded_by_what_is_read_once():
    told = run_process("info", "--help", env=os.environ | {"NO_COLOR": "1", "FORCE_COLOR": "1"})
    assert not [one for one in COLOURS if one in told.stdout]


def test_every_package_says_that_it_is_typed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert "py.typed" in settings["package-data"]["palpate"]
    assert (ROOT / "palpate" / "py.typed").is_file()
