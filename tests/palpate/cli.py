"""Runs the command line in this process, and as a user starts it."""

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from typer.testing import CliRunner, Result

from palpate.commands import app

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments) -> Result:
    """The command line in this process."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="palpate")


def done(*arguments) -> Result:
    """The command line in this process, which must succeed."""
    result = run(*arguments)
    assert result.exit_code == 0, (arguments, result.stderr)
    return result


def as_json(*arguments) -> Any:
    """What a command that succeeds says with --json."""
    return json.loads(done(*arguments, "--json").stdout)


def run_process(*arguments, code: str = "", **options) -> "subprocess.CompletedProcess[str]":
    """The command line, or `code` in Python, as a process of its own."""
    command = [sys.executable, *(("-c", code) if code else ("-m", "palpate.main")), *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=options.pop("cwd", ROOT), **options
    )


def assert_refused(result, *words: str, code: int = 2) -> None:
    """One clear line on stderr that holds the words, the exit code, and on stdout at most that as JSON."""
    status = result.exit_code if isinstance(result, Result) else result.returncode
    assert status == code, result.stderr
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    if result.stdout:  # with --json
        assert json.loads(result.stdout) == {"error": lines[0].removeprefix("palpate: "), "exit_code": code}
    assert lines[0].startswith("palpate: ")
    for word in words:
        assert word in lines[0]


def next_commands(result: Result) -> list[list[str]]:
    """What stands below "Next": each command as words, without the program's name and the purpose."""
    lines = result.stderr.partition("Next\n")[2].splitlines()
    return [shlex.split(line.strip().split("  ")[0])[1:] for line in lines if line.strip()]
