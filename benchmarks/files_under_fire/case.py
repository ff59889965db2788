"""One command on one file that is not as it should be."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Rng = np.random.Generator


@dataclass(frozen=True)
class Case:
    """A command, what is wrong with its file, and a check of what it read if it did not refuse it."""

    what: str
    arguments: list[str]
    wrong_number: Callable[[], str] = lambda: ""  # what was read otherwise than it stands there; or empty


def pick(rng: Rng, some: Any) -> Any:  # noqa: ANN401
    """One of some, by chance."""
    return some[int(rng.integers(len(some)))]
