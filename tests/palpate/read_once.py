"""Files that are read with the same options and hold the same are read once in a process of the tests.

What is read is immutable, and a study remembers by its arrays what it computed of them: commands on one file
then share that as well.
"""

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

LARGEST = 10_000_000  # bytes


def read_once(read: Callable[..., Any], kept: int = 30) -> Callable[..., Any]:
    """`read(path, options)`, for equal paths, content and options from memory. Errors are not remembered."""
    by_content = lru_cache(maxsize=kept)(lambda path, _content, _options, options: read(path, options.it))

    def reader(path: Path, options: Any) -> Any:
        if not path.is_file() or path.stat().st_size > LARGEST:
            return read(path, options)
        content = hashlib.sha256(path.read_bytes()).digest()
        return by_content(path, content, repr(options), _Unseen(options))

    return reader


class _Unseen:
    """Holds what makes no difference to a cache: its text does already, and it may have no hash."""

    def __init__(self, it: Any) -> None:
        self.it = it

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Unseen)

    def __hash__(self) -> int:
        return 0
