"""Findings of an examination of the machine or of connected devices, before power is switched on."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from functools import partial


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARN = "warn"  # works, but not as well as it should; or an optional part is missing
    SKIP = "skip"  # could not be checked; the remedy is what would check it
    FAIL = "fail"  # the arm must not be powered, or palpate will not work


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    subject: str  # what was checked, such as "servo 2 (joint 2)"
    text: str  # result, with units
    remedy: str = ""  # what to do, empty without a problem
    level: Level = Level.OK


class Examinable(ABC):
    """A bus or device that can report what is connected; optional for a driver."""

    @abstractmethod
    def examine(self) -> tuple[Finding, ...]:
        """Check every device: whether it is present, agrees with the robot file, and reports no error.

        Called after `configure`, even if that failed, and never while the torque is on. It may take seconds.
        It changes no setting and never switches a torque on.

        Raises:
            DeviceError: no device can be asked, for example because the port is not open.
        """

    def tick_wire_s(self) -> float | None:
        """Return the shortest time that the bytes of one tick take on the wire [s]; None if unknown."""
        return None


ok = partial(Finding, level=Level.OK)  # without a remedy
warn = partial(Finding, level=Level.WARN)
skip = partial(Finding, level=Level.SKIP)
fail = partial(Finding, level=Level.FAIL)


def graded(subject: str, text: str, *problems: tuple[Level, object, str]) -> Finding:
    """Make a finding with the first problem whose condition is true; ok if there is none.

    Args:
        subject: checked item.
        text: result, with units.
        problems: level, whether it holds, and remedy of each, the worst first.
    """
    for level, holds, remedy in problems:
        if holds:
            return Finding(subject, text, remedy, level)
    return ok(subject, text)
