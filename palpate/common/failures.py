"""The one place where a failure becomes one line on stderr and an exit code; with `--json`, JSON as well."""

import errno
import json
import os
import sys
import traceback
from typing import Any

import typer
from pydantic import ValidationError
from typer.core import TyperGroup

from palpate.common.created_folders import remove_empty_folders
from palpate.common.preflight import library_remedy
from palpate.common.python_words import ErrorWording
from robot_io.errors import DeviceError, InputError, PalpateError, UnloggedError
from robot_io.files.file_model import one_line

BAD_INPUT = 2
FAILED = 1
DISK_FULL = 3
INTERRUPTED = 130
DEBUG_VARIABLE = "PALPATE_DEBUG"
_MOST_SHOWN = 60  # characters of a value that is refused
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class OneLineGroup(TyperGroup):
    """A command group that never shows a traceback: a failure is one line that a user can act on."""

    def main(self, *args: Any, **extra: Any) -> Any:  # noqa: ANN401
        """Run the command and leave with its exit code; see `TyperGroup.main`."""
        given = extra.get("args", args[0] if args else None)
        before, ErrorWording.of_command_line = ErrorWording.of_command_line, True
        as_json, JsonOutput.was_printed = "--json" in (sys.argv[1:] if given is None else given), False
        try:
            code = super().main(*args, **(extra | {"standalone_mode": False}))
            sys.stdout.flush()
        except typer.Abort:
            sys.exit(report("interrupted", INTERRUPTED, as_json=as_json))
        except Exception as error:
            sys.exit(report_error(error, as_json=as_json))
        finally:
            ErrorWording.of_command_line = before
            remove_empty_folders()
        if code == INTERRUPTED:
            report("interrupted", INTERRUPTED)
        sys.exit(code if isinstance(code, int) else 0)


def report_error(error: Exception, *, as_json: bool = False) -> int:
    """Print one line for `error` and return the exit code that goes with it; see `report`."""
    if os.environ.get(DEBUG_VARIABLE):
        traceback.print_exception(error)
    if isinstance(error, BrokenPipeError):
        return _give_up_output()
    if isinstance(error, OSError) and error.filename is None and error.errno in _NO_ROOM:
        _give_up_output()
    where = f"set {DEBUG_VARIABLE}=1 to see where; please report it"
    text, code = f"internal error, {type(error).__name__}: {error} ({where})", FAILED
    match error:
        case UnloggedError():
            text = str(error)
        case InputError():
            text, code = str(error), BAD_INPUT
        case PalpateError():
            text = str(error)
        case typer.TyperException():
            text, code = _usage(error), error.exit_code
        case OSError() if error.filename is not None:
            text, code = f"{error.filename}: {error.strerror}", BAD_INPUT
        case OSError() if error.errno in _NO_ROOM:  # files that are written are named
            text = f"cannot write the output: {error.strerror}"
        case MemoryError():
            text = "the memory is full; take fewer runs, or a shorter recording"
        case ImportError() if remedy := library_remedy(error):
            text = f"a library of the system is missing ({error}); {remedy}"
    return report(text, DISK_FULL if _disk_is_full(error) else code, as_json=as_json)


def _disk_is_full(error: BaseException | None) -> bool:
    """Whether a disk that takes nothing more, or fails, is behind it: the input may be as good as can be."""
    while error is not None and not isinstance(error, OSError | DeviceError):  # a line that fails is no disk
        error = error.__cause__
    return isinstance(error, OSError) and error.errno in _NO_ROOM


def report(text: str, code: int, *, as_json: bool = False) -> int:
    """Print `text` as one line on stderr, with nothing that a terminal would obey, and return `code`.

    With `as_json` also as one line on stdout, `{"error": ..., "exit_code": ...}`, where JSON is read; but not
    after a result, which says itself how it ended.
    """
    line = one_line(text)
    if as_json and not JsonOutput.was_printed:
        print(json.dumps({"error": line, "exit_code": code}))
    print("palpate: " + line, file=sys.stderr)
    return code


def _usage(error: typer.TyperException) -> str:
    context = getattr(error, "ctx", None)
    hint = f" (see: {context.command_path} --help)" if context else ""
    text = error.format_message().replace("Value error, ", "").partition(", unable to parse")[0]
    if isinstance(error.__cause__, ValidationError):
        given = str(error.__cause__.errors(include_url=False)[0]["input"])[:_MOST_SHOWN]
        text = text.replace(": Input should", f": '{given}' should", 1)
    return text.rstrip(".") + hint


def _give_up_output() -> int:
    """Nobody takes our output (`| head`, a full disk); keep the interpreter from complaining at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


class JsonOutput:
    """There is one for each command, whatever happens after it."""

    was_printed = False
