"""The one family of errors: each says the value, the place and the valid choices in one line."""

import traceback
from pathlib import Path


class PalpateError(Exception):
    """Base of every error that palpate raises on purpose; its text is one line that a user can act on."""


class InputError(PalpateError, ValueError):
    """Something the user supplied (file, option, value) is not valid; the command line exits with 2."""


class UnknownNameError(InputError, KeyError):
    """A name that a registry does not hold; also a `KeyError`, so that mappings behave as such."""

    __str__ = InputError.__str__  # KeyError would show the message in quotes


class DeviceError(PalpateError):
    """A device or its bus failed."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer before its deadline."""


class ProtocolError(DeviceError):
    """What came over a wire is not what its protocol allows; all of it was ignored."""


class LifecycleError(PalpateError):
    """A call came in the wrong state, such as a command to a robot that is not active."""


class SafetyTripError(PalpateError):
    """A limit was exceeded; the guard is latched until it is re-armed."""


class SessionError(InputError):
    """A session file cannot be written, or what was read is not a whole session."""


class UnloggedError(SessionError):
    """What happened in a session did not all reach its file, whatever the user supplied; exits with 1."""


def in_words(error: BaseException, own_file: str = "") -> str:
    """Kind, message and place of an error, such as "ZeroDivisionError: division by zero (my.py, line 2)".

    Args:
        error: as it was caught; what the interpreter itself adds to its traceback is left out.
        own_file: whose last line is named, if the error passed through it, even if a library raised it.
    """
    text = f"{type(error).__name__}: {error}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]
    if isinstance(error, SyntaxError) or not frames:
        return text  # a SyntaxError says where it is
    last = next((frame for frame in reversed(frames) if frame.filename == own_file), frames[-1])
    file = Path(last.filename)
    name = f"{file.parent.name}/{file.name}" if file.stem == "__init__" else file.name
    return f"{text} ({name}, line {last.lineno})"
