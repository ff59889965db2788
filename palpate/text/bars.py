"""Bars of characters in tables."""

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.text import Text

LONGEST = 18  # characters
_SHORT = 2  # characters, where the table has little room: words and numbers go first
_ROOMY = 80  # characters of the whole table
_FULL, _EIGHTHS = "█", " ▏▎▍▌▋▊▉"


class Bar:
    """A share from 0 to 1, as long as there is room.

    Args:
        share: cut off at either end.
        style: rich's word for its color.
        longest: characters of a share of 1.
    """

    def __init__(self, share: float, style: str, longest: int = LONGEST) -> None:
        self.share = max(0.0, min(share, 1.0))
        self.style = style
        self.longest = longest

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """Between a short and the longest bar."""
        room = self.longest if options.max_width >= _ROOMY else _SHORT
        return Measurement(min(_SHORT, room), room)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Drawn in eighths of a character."""
        eighths = round(self.share * min(options.max_width, self.longest) * 8)
        drawn = _FULL * (eighths // 8) + _EIGHTHS[eighths % 8]
        yield Text(drawn.strip(), style=self.style)
