"""What a driver can say of the devices at its other end, for somebody who checks the wiring before power."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How an observation is to be taken."""

    OK = "ok"
    WARN = "warn"  # the arm can be used, but not as well as it should
    FAIL = "fail"  # the arm must not be powered


@dataclass(frozen=True, slots=True)
class Observation:
    """One thing that was looked at."""

    subject: str  # the device, such as "servo 2 (joint 2)"
    value: str  # what was found, with units
    verdict: Verdict = Verdict.OK  # whether that is as it should be
    remedy: str = ""  # what to do, empty where all is well


class Examinable(ABC):
    """A bus or device that can say what is connected. Offering this is up to the driver."""

    @abstractmethod
    def examine(self) -> tuple[Observation, ...]:
        """Look at every device: is it there, is it the one of the robot file, is it well.

        Called after `configure`, also after one that failed, and never while the torque is on. May take
        seconds. It changes no setting, and it never switches a torque on.

        DeviceError: nothing can be asked, such as on a port that is not open.
        """

    def tick_wire_s(self) -> float | None:
        """How long the bytes of one tick are on the wire at least [s]; None where nobody knows."""
        return None


def warn(subject: str, value: str, remedy: str) -> Observation:
    """Something that one can live with."""
    return Observation(subject, value, Verdict.WARN, remedy)


def fail(subject: str, value: str, remedy: str) -> Observation:
    """Something that must be put right first."""
    return Observation(subject, value, Verdict.FAIL, remedy)
