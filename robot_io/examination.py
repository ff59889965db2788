"""What is found when a machine or the devices at the other end of a driver are looked at before power."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How much a finding matters."""

    OK = "ok"
    WARN = "warn"  # it works, but not as well as it should, or a part that not everybody needs is absent
    FAIL = "fail"  # the arm must not be powered, or palpate will not work


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    subject: str  # what was looked at, such as "servo 2 (joint 2)"
    level: Level
    text: str  # what was found, with units
    remedy: str = ""  # what to do, empty where all is well


class Examinable(ABC):
    """A bus or device that can say what is connected. Offering this is up to the driver."""

    @abstractmethod
    def examine(self) -> tuple[Finding, ...]:
        """Look at every device: is it there, is it the one of the robot file, is it well.

        Called after `configure`, also after one that failed, and never while the torque is on. May take
        seconds. It changes no setting, and it never switches a torque on.

        DeviceError: nothing can be asked, such as on a port that is not open.
        """

    def tick_wire_s(self) -> float | None:
        """How long the bytes of one tick are on the wire at least [s]; None where nobody knows."""
        return None


def ok(subject: str, text: str) -> Finding:
    """A finding without complaint."""
    return Finding(subject, Level.OK, text)


def warn(subject: str, text: str, remedy: str) -> Finding:
    """Something that one can live with."""
    return Finding(subject, Level.WARN, text, remedy)


def fail(subject: str, text: str, remedy: str) -> Finding:
    """Something that must be put right first."""
    return Finding(subject, Level.FAIL, text, remedy)


def graded(subject: str, text: str, *complaints: tuple[Level, object, str]) -> Finding:
    """A finding with the first complaint (level, whether it holds, remedy) that holds; ok if none does."""
    for level, holds, remedy in complaints:
        if holds:
            return Finding(subject, level, text, remedy)
    return ok(subject, text)
