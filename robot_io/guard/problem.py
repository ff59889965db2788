"""What is wrong with an arm in motion, and what its user can do about it."""

from typing import NamedTuple


class Problem(NamedTuple):
    """One reason to stop.

    Attributes:
        text: one sentence without its full stop: what is wrong, where, and by how much.
        remedy: what to do, for the end of the line that the user reads; empty where nobody can do anything.
    """

    text: str
    remedy: str = ""
