"""Starting several devices so that a failure half-way leaves none of them on, and stopping all of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Literal, Self

from robot_io.errors import DeviceError
from robot_io.interfaces import Component

_ATTEMPTS = 3  # against interrupts, such as several Ctrl-C
Labelled = tuple[str, Component]
"""A component and what to call it in messages."""


class Opened(ABC):
    """What a `with` configures on entry and closes on exit; a failure to close hides no error before it."""

    @abstractmethod
    def configure(self) -> None:
        """Open it. DeviceError: a device is absent or is another one."""

    @abstractmethod
    def close(self) -> None:
        """Release it, torque or force off first; can be called again."""

    def __enter__(self) -> Self:
        self.configure()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self.close()
        except DeviceError as failure:
            if error is None:
                raise
            error.add_note(f"closing failed too: {failure}")


def start_all(
    components: Sequence[Labelled],
    step: Literal["configure", "activate"],
    *,
    undo: Literal["close", "deactivate"],
) -> None:
    """Take each component through `step`, in order; if one fails, `undo` it and all before it.

    The failing component is undone too: a drive may have powered two of three motors before it failed.

    DeviceError: a component failed; or, as it is, whatever else interrupted (such as Ctrl-C).
    """
    for index, (label, component) in enumerate(components):
        try:
            getattr(component, step)()
        except BaseException as error:
            problem = f"{label}: {step} failed: {error}"
            try:
                undo_all(components[: index + 1], undo)
            except DeviceError as second:
                problem += f"; then {second}"
                error.add_note(problem)
            if isinstance(error, DeviceError):
                raise DeviceError(problem) from error
            raise


def undo_all(components: Sequence[Labelled], step: Literal["close", "deactivate"]) -> None:
    """Take every component through `step`, last one first, whatever happens on the way.

    A Ctrl-C in the middle does not leave a motor on: the step is taken again, the rest follows, and only then
    is it passed on.

    DeviceError: some components failed, all named.
    """
    failures: list[tuple[str, Exception]] = []
    interrupts: list[BaseException] = []
    for label, component in reversed(components):
        for error in _insist(getattr(component, step)):
            if isinstance(error, Exception):
                failures.append((label, error))
            else:
                interrupts.append(error)
    if interrupts:
        raise interrupts[0]
    if failures:
        text = "; ".join(f"{label}: {step} failed: {error}" for label, error in failures)
        raise DeviceError(text) from failures[0][1]


def _insist(call: Callable[[], None]) -> list[BaseException]:
    """Call until it was not interrupted, and return what it raised; a plain failure is not repeated."""
    caught: list[BaseException] = []
    for _ in range(_ATTEMPTS):
        try:
            call()
        except Exception as error:  # a driver's bug must not leave the next motor on
            return [*caught, error]
        except BaseException as interrupt:
            caught.append(interrupt)
        else:
            break
    return caught
