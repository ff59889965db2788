"""Display in notebooks: a progress bar, and the address of a page."""

import sys
import time
from collections.abc import Callable
from html import escape

_REFRESH_S = 0.2


class PageAddress(str):
    """Address of a page on this machine; a notebook shows it as a link."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return f'<a href="{escape(self)}" target="_blank">{escape(self)}</a>'


def notebook_progress() -> Callable[[str, float], None]:
    """Make a progress bar below the notebook's cell; outside of a notebook it does nothing.

    Returns:
        Function of the current step and the fraction of it that is done; an empty step clears the bar.
    """
    if "ipykernel" not in sys.modules:
        return lambda what, share: None
    from IPython.display import HTML, display  # noqa: PLC0415 (installed with ipykernel)

    handle, next_s = display(HTML(""), display_id=True), 0.0

    def report(what: str, share: float) -> None:
        nonlocal next_s
        if not what:
            handle.update(HTML(""))
        elif (now_s := time.monotonic()) >= next_s:
            next_s = now_s + _REFRESH_S
            handle.update(HTML(f'<progress value="{share:.2f}"></progress> {escape(what)}'))

    return report
