"""A plotly figure in the page, of which only what changed is sent, and only what is seen is drawn."""

from collections.abc import Mapping, Sequence
from typing import Any

import nicegui.elements.plotly  # noqa: F401, serves plotly.js; plotly's Python, which it also has, is slow to import
from nicegui.element import Element

Figure = dict[str, Any]
Restyle = tuple[Mapping[str, Sequence[Any]], list[int]]


class Plot(Element, component="plot.js"):
    """One figure; what changes before the browser is ready for it is sent when it is."""

    def __init__(self, figure: Figure) -> None:
        super().__init__()
        self.figure: Figure = figure
        self._props["figure"] = figure
        self._is_ready = False
        self.on("ready", self._begin)

    def replace(self, figure: Figure) -> None:
        """Draw another figure."""
        self.figure = figure
        self._send("replace", figure)

    def restyle(self, update: Restyle) -> None:
        """Change some traces."""
        values, traces = update
        for place, number in enumerate(traces):
            self.figure["data"][number] |= {name: each[place] for name, each in values.items()}
        self._send("restyle", values, traces)

    def relayout(self, layout: Figure) -> None:
        """Change the layout."""
        self.figure["layout"] |= layout
        self._send("relayout", layout)

    def _send(self, method: str, *what: object) -> None:
        if self._is_ready:
            self.run_method(method, *what)

    def _begin(self) -> None:
        self._is_ready = True
        self._send("replace", self.figure)
