"""The outcome of one check."""

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How much a finding matters."""

    OK = "ok"
    WARN = "warn"  # something works less well, or a part that not everybody needs is absent
    FAIL = "fail"  # palpate will not work


@dataclass(frozen=True)
class Finding:
    """One line of the doctor's report."""

    subject: str  # what was looked at
    level: Level
    text: str  # what was found
    remedy: str = ""  # what to do, empty when nothing


def ok(subject: str, text: str) -> Finding:
    """A finding without complaint."""
    return Finding(subject, Level.OK, text)


def warn(subject: str, text: str, remedy: str) -> Finding:
    """A finding that one can live with."""
    return Finding(subject, Level.WARN, text, remedy)


def fail(subject: str, text: str, remedy: str) -> Finding:
    """A finding that keeps palpate from working."""
    return Finding(subject, Level.FAIL, text, remedy)


def graded(subject: str, text: str, *complaints: tuple[Level, object, str]) -> Finding:
    """A finding with the first complaint (level, whether it holds, remedy) that holds; ok if none does."""
    for level, holds, remedy in complaints:
        if holds:
            return Finding(subject, level, text, remedy)
    return ok(subject, text)
