"""The same work on several things."""

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


class Each(Protocol):
    """Does the work on each task; `begin` is told its number first. Work and tasks can be sent elsewhere."""

    def __call__(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], begin: Callable[[int], None]
    ) -> list[Result]:
        """Results in the order of the tasks."""
        ...


def one_by_one(
    work: Callable[[Task], Result], tasks: Sequence[Task], begin: Callable[[int], None]
) -> list[Result]:
    """All of it here; see `Each`."""
    found = []
    for number, task in enumerate(tasks):
        begin(number)
        found.append(work(task))
    return found
