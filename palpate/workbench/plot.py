"""A plotly figure in the page, of which only what changed is sent."""

from typing import Any

from nicegui import ui

from palpate.workbench.curves import Figure, Restyle


class Plot:
    """One figure. Until the browser has drawn it for the first time, all of it is sent again."""

    def __init__(self, figure: Figure) -> None:
        self._drawn = False
        self.element = ui.plotly(figure).classes("plot")
        name = f"window.drawn{self.element.id}"
        once = f"() => {{ if (!{name}) {{ {name} = true; emit(); }} }}"
        self.element.on("plotly_afterplot", self._is_drawn, js_handler=once)

    def replace(self, figure: Figure) -> None:
        """Draw another figure."""
        self.element.update_figure(figure)

    def restyle(self, update: Restyle) -> None:
        """Change some traces."""
        values, traces = update
        figure: Any = self.element.figure
        for place, number in enumerate(traces):
            figure["data"][number] |= {name: each[place] for name, each in values.items()}
        if self._drawn:
            self.element.run_plot_method("restyle", values, traces)
        else:
            self.element.update()

    def relayout(self, layout: dict[str, Any]) -> None:
        """Change the layout."""
        figure: Any = self.element.figure
        figure["layout"] |= layout
        if self._drawn:
            self.element.run_plot_method("relayout", layout)
        else:
            self.element.update()

    def _is_drawn(self) -> None:
        self._drawn = True
        self.element.update()  # what changed while the browser was drawing
