"""What a section of the report is; a new one is one new file in `sections`."""

from abc import ABC, abstractmethod
from typing import ClassVar

from palpate.report.report import Report
from robot_io.registry import Registry


class Section(ABC):
    """One section.

    Class attributes:
        name: snake_case; the anchor of the section.
        title: its headline.
        place: sections are shown in this order, from the smallest on.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    place: ClassVar[int]

    @abstractmethod
    def html(self, report: Report) -> str:
        """The section's body; empty if it has nothing to tell. Text from files must be escaped."""


SECTIONS: Registry[Section] = Registry(
    "report section",
    Section,  # type: ignore[type-abstract]
    "palpate.report.sections",
)


def in_order() -> list[Section]:
    """All sections as they are shown."""
    return sorted((section() for section in SECTIONS.values()), key=lambda section: section.place)
