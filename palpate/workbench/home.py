"""What the server shows; data is read while the page's library is still being imported."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from estimation.data.import_options import ImportOptions
from robot_io.errors import PalpateError

if TYPE_CHECKING:
    from palpate.workbench.bench import Bench
    from palpate.workbench.foxglove_feed import Feed


@dataclass
class Home:
    """What the server shows.

    Attributes:
        folder: whose sessions are offered.
        file: that was asked for; None for none.
        riddle: whether something was hidden for the user to find.
        bench: once data was read.
        raw: a drawing of what a session measured; empty for other files.
        reading: what is being read; empty once that is done.
        error: why it could not be.
        feed: for Foxglove, if that was asked for.
        open: makes a bench of a file.
    """

    folder: Path
    file: Path | None = None
    riddle: bool = False
    bench: "Bench | None" = None
    raw: str = ""
    reading: str = ""
    error: str = ""
    feed: "Feed | None" = None
    open: "Callable[[Path, ImportOptions], Bench] | None" = None

    @property
    def waiting(self) -> str:
        """What is shown while the data is being read, as HTML."""
        return f'<p class="quiet">{escape(self.reading or "opening")} …</p>{self.raw}'

    def read(self, make: "Callable[[], Bench]", what: str) -> None:
        """Make the bench in another thread; the page shows what was measured and waits for it."""
        self.reading = what
        Thread(target=self._read, args=(make,), daemon=True).start()

    def _read(self, make: "Callable[[], Bench]") -> None:
        try:
            self.bench = make()
        except PalpateError as error:
            self.error = str(error)
        finally:
            self.reading = ""
