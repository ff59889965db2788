"""All errors that palpate raises on purpose: each states value, place and valid choices in one line."""

import traceback
from pathlib import Path


class PalpateError(Exception):
    """Base of every error that palpate raises on purpose; its text is one line with a remedy."""


class InputError(PalpateError, ValueError):
    """User input (file, option, value) is invalid; the command line exits with 2."""


class UnknownNameError(InputError, KeyError):
    """A name that a registry does not contain; also a `KeyError`, so that mappings behave as usual."""

    __str__ = InputError.__str__  # KeyError would show the message in quotes


class DeviceError(PalpateError):
    """A device or its bus failed."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer before its deadline."""


class ProtocolError(DeviceError):
    """Bytes from a wire violate their protocol; all of them were ignored."""


class LifecycleError(PalpateError):
    """A call in the wrong state, such as a command to a robot that is not active."""


class SafetyTripError(PalpateError):
    """A limit was exceeded; the guard is latched until it is re-armed."""


class SessionError(InputError):
    """A session file cannot be written, or a file is not a whole session."""


class UnloggedError(SessionError):
    """Not everything in a session reached its file, independent of user input; exits with 1."""


def describe_error(error: BaseException, own_file: str = "") -> str:
    """Write kind, message and place, such as "ZeroDivisionError: division by zero (my.py, line 2)".

    Args:
        error: the exception; the interpreter's own frames are left out.
        own_file: file whose last line is named if the error passed through it, even if a library raised it.
    """
    text = f"{type(error).__name__}: {error}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]
    if isinstance(error, SyntaxError) or not frames:
        return text  # a SyntaxError says where it is
    last = next((frame for frame in reversed(frames) if frame.filename == own_file), frames[-1])
    file = Path(last.filename)
    name = f"{file.parent.name}/{file.name}" if file.stem == "__init__" else file.name
    return f"{text} ({name}, line {last.lineno})"


def one_line(text: object) -> str:
    """Write foreign text for a message: one line, without control characters.

    Args:
        text: anything.
    """
    return "".join(char if char.isprintable() else "?" for char in " ".join(str(text).split()))


def error_text(error: Exception) -> str:
    """Write an exception for a message: one line, with its type unless the text is meant for users.

    Args:
        error: the exception; the text of a `PalpateError` is meant for users.
    """
    text = one_line(error)
    return text if isinstance(error, PalpateError) else f"{type(error).__name__}: {text}"
