"""Result of a run of the loop: outcome, counts and timing."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from palpate.control.loop.timing import SectionTiming
from palpate.robot_io.errors import PalpateError, SafetyTripError


class Outcome(StrEnum):
    """Reason for the end of the loop."""

    FINISHED = "finished"  # the task was done
    STOPPED = "stopped"  # stopped on request
    TRIPPED = "tripped"  # a limit, a device or an exception


@dataclass(frozen=True, slots=True)
class LoopResult:
    """Result of a run of the loop; torque off was commanded in every case."""

    outcome: Outcome  # finished, stopped or tripped
    cause: str = ""  # why it was stopped or tripped; empty when the task was done
    ticks: int = 0  # ticks that were run
    overruns: int = 0  # ticks that ended after the next one was due
    skipped: int = 0  # grid times without a tick
    dropped: int = 0  # records lost because the log was full
    log_failures: int = 0  # failed calls of the log, which do not stop the arm
    log_error: str = ""  # why the log is incomplete (such as a full disk), empty if no reason is known
    observer_error: str = ""  # why the observer was switched off, empty if it was not
    unsent: int = 0  # commands that could not be sent
    deactivation_error: str = ""  # why torque off could not be confirmed; empty if it was
    duration_s: float = 0.0  # time on the loop's clock [s]
    wall_s: float = 0.0  # time of the wall clock [s]
    timing: Mapping[str, SectionTiming] = field(default_factory=dict)  # duration of the tick's sections
    error: Exception | None = None  # the exception behind the trip, if there was one

    @property
    def is_clean(self) -> bool:
        """Whether no tick was late, no record lost and the torque confirmed off."""
        problems = self.log_error or self.observer_error or self.deactivation_error
        return not (problems or self.overruns or self.dropped or self.unsent)

    def one_line(self) -> str:
        """Summarize outcome and problems in one line."""
        text = f"{self.outcome}{': ' if self.cause else ''}{self.cause}; {self.ticks} ticks"
        for count, what in (
            (self.overruns, "overruns"),
            (self.dropped, "records dropped"),
            (self.unsent, "commands not sent"),
        ):
            text += f", {count} {what}" if count else ""
        for problem, what in (
            (self.log_error, "the log is not complete"),
            (self.observer_error, "online estimation was switched off"),
            (self.deactivation_error, "the torque may still be on"),
        ):
            text += f"; {what}: {problem}" if problem else ""
        return text

    def raise_for_trip(self) -> None:
        """Raise an error if the guard tripped, or if the torque may still be on.

        Raises:
            SafetyTripError: a limit was exceeded, or the torque could not be switched off.
            PalpateError: a device or the task failed; chained to the original exception.
        """
        if self.deactivation_error:
            is_in_cause = not self.cause or self.deactivation_error in self.cause
            reason = "" if is_in_cause else f"; the arm was stopped: {self.cause}"
            raise SafetyTripError(
                f"the torque may still be on; cut the power: {self.deactivation_error}{reason}"
            ) from self.error
        if self.outcome is Outcome.TRIPPED:
            kind = PalpateError if self.error else SafetyTripError
            raise kind(f"the arm was stopped: {self.cause}") from self.error
