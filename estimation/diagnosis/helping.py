"""One channel's work on many things, shared with a process that has no channel left to diagnose.

Who asks for help works on as well: each task goes to whoever is free, by its number.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

from estimation.diagnosis.each import Result, Task


@dataclass(frozen=True)
class Help:
    """What is asked for: the same work on each task."""

    work: Callable[[Any], Any]
    tasks: Sequence[Any]


@dataclass(frozen=True)
class Done:
    """A task that is done, by its number; who asked for help keeps the result, and sends none."""

    number: int
    result: Any = None


@dataclass
class Shared:
    """Help that was asked for, as it stands.

    Attributes:
        asker: the pipe to who asked.
        help: what for.
        waiting: numbers of tasks that nobody has begun.
        found: results of the helpers by number.
        helpers: how many are at work.
        asker_waits: whether who asked has nothing left to do but to wait for them.
    """

    asker: Connection
    help: Help
    waiting: deque[int]
    found: dict[int, Any] = field(default_factory=dict)
    helpers: int = 0
    asker_waits: bool = False

    def join(self, helper: Connection) -> None:
        """Let a process help that has nothing else to do."""
        self.helpers += 1
        helper.send(self.help)
        self.give(helper)

    def take(self, worker: Connection, done: Done) -> bool:
        """What a worker did; whether it works on."""
        if worker is not self.asker:
            self.found[done.number] = done.result
        return self.give(worker)

    def give(self, worker: Connection) -> bool:
        """The next task to a worker, or the word that there is none; whether there was one.

        Who asked gets what the helpers found once the last of them is done.
        """
        if self.waiting:
            worker.send(self.waiting.popleft())
            return True
        worker.send(None)
        self.asker_waits |= worker is self.asker
        self.helpers -= worker is not self.asker
        if self.asker_waits and not self.helpers:
            self.asker.send(self.found)
        return False


def shared(
    parent: Connection, work: Callable[[Task], Result], tasks: Sequence[Task], begin: Callable[[int], None]
) -> list[Result]:
    """Work on tasks with the help of others; see `estimation.diagnosis.each.Each`."""
    parent.send(Help(work, tasks))
    found: dict[int, Result] = {}
    while (number := parent.recv()) is not None:
        begin(number)
        found[number] = work(tasks[number])
        parent.send(Done(number))
    found |= parent.recv()
    return [found[number] for number in range(len(tasks))]


def lend_a_hand(parent: Connection, asked: Help) -> None:
    """Do tasks as they are given out, until there are no more."""
    while (number := parent.recv()) is not None:
        parent.send(Done(number, asked.work(asked.tasks[number])))
