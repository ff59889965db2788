"""Report a command's failure as one line with an exit code, and remove folders that stayed empty.

On the command line an error names options (`--unit`); in Python it names keywords (`units=`). With `--json`
a failure is also printed as JSON.
"""

import errno
import inspect
import json
import os
import re
import shlex
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import typer
from typer.core import TyperGroup

from palpate.common.preflight import library_remedy
from palpate.robot_io.errors import DeviceError, InputError, PalpateError, UnloggedError, one_line
from palpate.robot_io.extras import missing_package

BAD_INPUT = 2
FAILED = 1
DISK_FULL = 3
INTERRUPTED = 130
DEBUG_VARIABLE = "PALPATE_DEBUG"
_MOST_SHOWN = 60  # characters shown of a rejected value
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


class OneLineGroup(TyperGroup):
    """Command group that reports each failure as one line that a user can act on, without a traceback."""

    def main(self, *args: Any, **extra: Any) -> Any:  # noqa: ANN401
        """Run the command and exit with its exit code; see `TyperGroup.main`."""
        given = extra.get("args", args[0] if args else None)
        as_json, JsonOutput.was_printed = "--json" in (sys.argv[1:] if given is None else given), False
        try:
            with command_line_wording():
                code = super().main(*args, **(extra | {"standalone_mode": False}))
            sys.stdout.flush()
        except Exception as error:
            # Python 3.11 wraps an interrupt that occurs while a class is created.
            if isinstance(error, typer.Abort) or isinstance(error.__cause__, KeyboardInterrupt):
                sys.exit(report("interrupted", INTERRUPTED, as_json=as_json))
            sys.exit(_report_error(error, as_json=as_json))
        finally:
            remove_empty_folders()
        if code == INTERRUPTED:
            report("interrupted", INTERRUPTED)
        sys.exit(code if isinstance(code, int) else 0)


def _report_error(error: Exception, *, as_json: bool = False) -> int:
    """Print one line for `error` and return the exit code that goes with it; see `report`."""
    if os.environ.get(DEBUG_VARIABLE):
        traceback.print_exception(error)
    if isinstance(error, BrokenPipeError):
        return _discard_output()
    if isinstance(error, OSError) and error.filename is None and error.errno in _NO_ROOM:
        _discard_output()
    where = f"set {DEBUG_VARIABLE}=1 to see where it occurred; please report this error"
    text, code = f"internal error, {type(error).__name__}: {error} ({where})", FAILED
    match error:
        case InputError() if not isinstance(error, UnloggedError):
            text, code = str(error), BAD_INPUT
        case PalpateError():
            text = str(error)
        case typer.TyperException():
            text, code = _usage(error), error.exit_code
        case OSError() if error.filename is not None:
            text, code = f"{error.filename}: {error.strerror}", BAD_INPUT
        case OSError() if error.errno in _NO_ROOM:  # other errors of files name the file
            text = f"cannot write the output: {error.strerror}"
        case MemoryError():
            text = "the memory is full; use fewer runs, or a shorter recording"
        case ModuleNotFoundError() if missing := missing_package(error.name):
            text, code = missing, BAD_INPUT
        case ImportError() if remedy := library_remedy(error):
            text = f"a system library is missing ({error}); {remedy}"
    # A full or failing disk may be the cause, rather than the input.
    cause: BaseException | None = error
    # A failed line is no disk error.
    while cause is not None and not isinstance(cause, OSError | DeviceError):
        cause = cause.__cause__
    is_disk_full = isinstance(cause, OSError) and cause.errno in _NO_ROOM
    return report(text, DISK_FULL if is_disk_full else code, as_json=as_json)


def report(text: str, code: int, *, as_json: bool = False) -> int:
    """Print `text` as one line on stderr, without control sequences, and return `code`.

    With `as_json`, also print one line on stdout, `{"error": ..., "exit_code": ...}`, for programs that read
    JSON. Nothing is added after a JSON result, which states its own outcome.

    Args:
        text: error message.
        code: exit code.
        as_json: whether to print JSON.
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
    from pydantic import ValidationError  # noqa: PLC0415, takes a tenth of a second to import

    if isinstance(error.__cause__, ValidationError):
        given = str(error.__cause__.errors(include_url=False)[0]["input"])[:_MOST_SHOWN]
        text = text.replace(": Input should", f": '{given}' should", 1)
    return text.rstrip(".") + hint


def _discard_output() -> int:
    """Discard further output (`| head`, a full disk), so that the interpreter exits without an error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


class JsonOutput:
    """Record of whether a command has printed its JSON result; a command prints at most one."""

    was_printed = False


_made: list[Path] = []  # folders created in this process, innermost first


def make_folder(folder: Path) -> None:
    """Create a folder with its parents, and record which of them are new.

    Args:
        folder: absolute, or relative to the current folder.

    Raises:
        OSError: the folder cannot be created.
    """
    place = folder.absolute()
    new = [path for path in (place, *place.parents) if not path.exists()]
    _made[:0] = new
    folder.mkdir(parents=True, exist_ok=True)


def remove_empty_folders() -> None:
    """Remove new folders that are still empty."""
    for folder in _made:
        with suppress(OSError):  # the folder is not empty, or was never created
            folder.rmdir()
    _made.clear()


_PAIRS = {"unit": "units", "column": "columns", "where": "where"}
_LISTS = {"context": "context", "effect": "effects"}
_NUMBERS = {"runs": "runs", "from": "start", "revision": "revision"}
_TEXTS = {"model": "model", "channel": "channel", "urdf": "arm", "table": "table"}
_FLAGS = {"fresh-runs": "fresh", "fresh": "fresh", "apply": "apply"}
_KEYWORDS = _LISTS | _NUMBERS | _TEXTS
_WORD = r"""(?:'[^']*'|"[^"]*"|[^\s'",;:()])+(?:,\d+)*(?<!\.)"""
_OPTION = re.compile(
    rf"--(?P<pair>{'|'.join(_PAIRS)})(?: (?P<key>[\w ]+?)=(?P<value>{_WORD}))?(?![\w-])"
    rf"|--(?P<flag>{'|'.join(_FLAGS)})(?![\w-])"
    # The word after such an option is its value only if punctuation or the end of the text follows.
    rf"|--(?P<name>{'|'.join(_KEYWORDS)})(?: (?P<given>(?:\S+\.py:\w+|{_WORD})(?=:|$|\)| says)))?(?![\w-])"
)
_COMMAND = re.compile(r"palpate (diagnose|add) --(apply|fresh)")
_PAIR = rf"({'|'.join(_PAIRS.values())})=\{{(\".*?\")\}}"
_ONE_AFTER_THE_OTHER = re.compile(rf"{_PAIR}(?: {_PAIR})+")
Class = TypeVar("Class", bound=type)


class ErrorWording:
    """Whether error messages name options or keywords; one setting for the whole process."""

    of_command_line = False


@contextmanager
def command_line_wording() -> Iterator[None]:
    """Let error messages name command-line options within the context."""
    before, ErrorWording.of_command_line = ErrorWording.of_command_line, True
    try:
        yield
    finally:
        ErrorWording.of_command_line = before


def python_wording(text: str) -> str:
    """Replace each command-line option with the equivalent keyword of `palpate.Study`.

    Args:
        text: text of an error.
    """
    text = _OPTION.sub(_keyword, _COMMAND.sub(r"study.\1(\2=True)", text))
    return _ONE_AFTER_THE_OTHER.sub(_joined, text)


def _joined(pairs: re.Match[str]) -> str:
    """Write one dictionary for each keyword of several pairs."""
    entries: dict[str, list[str]] = {}
    for keyword, entry in re.findall(_PAIR, pairs[0]):
        entries.setdefault(keyword, []).append(entry)
    return ", ".join(f"{keyword}={{{', '.join(own)}}}" for keyword, own in entries.items())


def _keyword(option: re.Match[str]) -> str:
    if pair := option["pair"]:
        value = f'{{"{option["key"]}": "{_unquoted(option["value"])}"}}' if option["key"] else ""
        return f"{_PAIRS[pair]}={value}"
    if flag := option["flag"]:
        return f"{_FLAGS[flag]}=True"
    name, value = option["name"], _unquoted(option["given"] or "")
    if value and name not in _NUMBERS:
        value = f'["{value}"]' if name in _LISTS else f'"{value}"'
    return f"{_KEYWORDS[name]}={value}"


def _unquoted(word: str) -> str:
    """Return a word without its shell quoting."""
    return "".join(shlex.split(word))


def with_python_wording(made: Class) -> Class:
    """Make errors of a class's public methods one printable line with Python keywords.

    On the command line, errors keep its wording and are made printable where they are reported.
    """

    @contextmanager
    def reworded() -> Iterator[None]:
        try:
            yield
        except PalpateError as error:
            if not ErrorWording.of_command_line:
                error.args = (one_line(python_wording(str(error))),)
            raise

    for name in dir(made):
        method = inspect.getattr_static(made, name)
        if inspect.isfunction(method) and (name == "__init__" or not name.startswith("_")):
            setattr(made, name, reworded()(method))
    return made
