"""What zenoh says when something is wrong, as one line without the places in its own source."""

import re

_PLACE = re.compile(r"\s+at /\S+\.rs:\d+\.?")
_MESSAGE = re.compile(r'Message \{ msg: "(.*)", location: .*?line: (\d+), column: (\d+)')
_SYNTAX = re.compile(r"--> (\d+):(\d+) .*= (.*)")
_MOST = 200  # characters


def cause(error: Exception) -> str:
    """The cause of a `zenoh.ZError`, for a person."""
    text = _PLACE.sub("", " ".join(str(error).split()))
    if found := _MESSAGE.search(text):
        what, line, column = found.groups()
    elif found := _SYNTAX.search(text):
        line, column, what = found.groups()
    else:
        return text[:_MOST]
    return f"line {line}, column {column}: {what}"[:_MOST]
