"""Reads a text file that somebody else wrote: no device, no pipe, and no more than such a file needs."""

import errno
from pathlib import Path

MOST_BYTES = 16 * 1024 * 1024


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is a device or a pipe, is larger than `most_bytes`, or is no UTF-8 text.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no file has such a name")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError("a device or a pipe, not a file")
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise ValueError(f"larger than {most_bytes} bytes, which no such file needs to be")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 text (byte {error.start})") from error
