"""What the server shows; data is read while the page's library is still being imported."""

from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from secrets import token_urlsafe
from threading import Thread
from typing import TYPE_CHECKING

from estimation.data.import_options import ImportOptions
from robot_io.errors import PalpateError

if TYPE_CHECKING:
    from palpate.workbench.foxglove_feed import Feed
    from palpate.workbench.state import WorkbenchState


@dataclass
class AppState:
    """What the server shows."""

    folder: Path  # whose sessions are offered
    file: Path | None = None  # that was asked for; None for none
    riddle: bool = False  # whether something was hidden for the user to find
    state: "WorkbenchState | None" = None  # once data was read
    raw: str = ""  # a drawing of what a session measured; empty for other files
    promised: set[Path] = field(default_factory=set)  # what a tab is about to write
    reading: str = ""  # what is being read; empty once that is done
    error: str = ""  # why it could not be
    reports: dict[str, Path] = field(default_factory=dict)  # that were written from the page, by their key
    feed: "Feed | None" = None  # for Foxglove, if that was asked for
    open: "Callable[[Path, ImportOptions], WorkbenchState] | None" = None  # makes a bench of a file

    @property
    def waiting(self) -> str:
        """What is shown while the data is being read, as HTML."""
        return f'<p class="quiet">{escape(self.reading or "opening")} …</p>{self.raw}'

    def serve_report(self, path: Path) -> str:
        """Make a report available to the browser; returns its address, which nobody can guess."""
        key = token_urlsafe(16)
        self.reports[key] = path
        return f"/report/{key}"

    def read(self, make: "Callable[[], WorkbenchState]", what: str) -> None:
        """Make the bench in another thread; the page shows what was measured and waits for it."""
        self.reading = what
        Thread(target=self._read, args=(make,), daemon=True).start()

    def _read(self, make: "Callable[[], WorkbenchState]") -> None:
        try:
            self.state = make()
        except PalpateError as error:
            self.error = str(error)
        finally:
            self.reading = ""
