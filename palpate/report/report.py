"""What a report tells."""

from dataclasses import dataclass

from palpate.findings.story import Story


@dataclass(frozen=True)
class Report:
    """What a report tells.

    Attributes:
        file: what was measured, as the user named it.
        facts: name and value of what was recorded when and how.
        stories: one for each channel.
        commands: that lead to this report, in order.
    """

    file: str
    facts: dict[str, str]
    stories: tuple[Story, ...]
    commands: tuple[str, ...]
