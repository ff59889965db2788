"""Where an error was raised, for errors of code that is not ours."""

import traceback
from pathlib import Path


def in_words(error: BaseException) -> str:
    """Kind, message and place of an error, such as "ZeroDivisionError: division by zero (my.py, line 2)".

    Args:
        error: as it was caught; what the interpreter itself adds to its traceback is left out.
    """
    text = f"{type(error).__name__}: {error}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")]
    if isinstance(error, SyntaxError) or not frames:
        return text  # a SyntaxError says where it is
    file = Path(frames[-1].filename)
    name = f"{file.parent.name}/{file.name}" if file.stem == "__init__" else file.name
    return f"{text} ({name}, line {frames[-1].lineno})"
