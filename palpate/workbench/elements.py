"""Elements of the page, and the texts shown on hover.

Texts may come from files, so each is set as one property, never as part of code or markup.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import nicegui.elements.plotly  # noqa: F401, serves plotly.js; plotly's Python, which it also has, is slow to import
import numpy as np
from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

from palpate.render import palette
from palpate.render.view import RANGE_MEANING
from palpate.robot_io.errors import PalpateError

AnyElement = TypeVar("AnyElement", bound=Element)


def set_props(element: AnyElement, **values: str | bool) -> AnyElement:
    """Set properties by key (aria_label sets aria-label), and return the element.

    `Element.props("key=value")` parses its text, so a quote in a value could inject further properties.

    Args:
        element: element to change.
        values: property values by key.
    """
    element.props.update({key.replace("_", "-"): value for key, value in values.items()})
    return element


def heading(text: str, title: str = "") -> None:
    """Add a heading.

    Args:
        text: text of the heading.
        title: text shown on hover.
    """
    element = TextElement(tag="h2", text=text)
    if title:
        set_props(element, title=title)


@contextmanager
def errors_as_warnings(**look: Any) -> Iterator[None]:  # noqa: ANN401, as `ui.notify` takes it
    """Show an error of the context's body as a warning on the page.

    Args:
        look: further options of `ui.notify`.
    """
    try:
        yield
    except PalpateError as error:
        ui.notify(str(error), type="warning", **look)


Figure = dict[str, Any]
Restyle = tuple[Mapping[str, Sequence[Any]], list[int]]


class Plot(Element, component="plot.js"):
    """One figure; changes made before the browser is ready are sent once it is."""

    def __init__(self, figure: Figure) -> None:
        super().__init__()
        self.figure: Figure = figure
        self._props["figure"] = figure
        self._is_ready = False

        def begin() -> None:
            self._is_ready = True
            self._send("replace", self.figure)

        self.on("ready", begin)

    def replace(self, figure: Figure) -> None:
        """Draw another figure.

        Args:
            figure: figure in plotly's JSON format.
        """
        self.figure = figure
        self._send("replace", figure)

    def restyle(self, update: Restyle) -> None:
        """Change some traces.

        Args:
            update: new values of each property, one for each trace, and the numbers of the traces.
        """
        values, traces = update
        for place, number in enumerate(traces):
            self.figure["data"][number] |= {name: each[place] for name, each in values.items()}
        self._send("restyle", values, traces)

    def relayout(self, layout: Figure) -> None:
        """Change the layout.

        Args:
            layout: changed layout keys.
        """
        self.figure["layout"] |= layout
        self._send("relayout", layout)

    def _send(self, method: str, *what: object) -> None:
        if self._is_ready:
            self.run_method(method, *what)


_AXIS = {
    "gridcolor": "#e8ecf0", "zerolinecolor": "#c3cbd3", "automargin": True,
    # invisible ticks keep the labels of two axes apart where they meet
    "ticks": "outside", "ticklen": 5, "tickcolor": "rgba(0,0,0,0)",
}  # fmt: skip


def curve(  # noqa: PLR0917, what a line is made of
    name: str, x: np.ndarray, y: np.ndarray, color: str, width: float, unit: str, **more: object
) -> dict[str, Any]:
    """Return a curve over x (n,) for plotly.

    Args:
        name: name in the legend.
        x: shape (n,).
        y: shape (n,).
        color: CSS color.
        width: width of the line [px].
        unit: unit of y.
        more: further keys of plotly's trace.
    """
    dash = more.pop("dash", "solid")
    return {
        "type": "scatter", "mode": "lines", "name": name, "x": x, "y": y, "connectgaps": False,
        "line": {"color": color, "width": width, "dash": dash, "simplify": True},
        "hovertemplate": f"%{{x:.4g}}: %{{y:.4g}} {unit}", **more,
    }  # fmt: skip


def axis(title: str, **more: object) -> dict[str, Any]:
    """Return an axis with its title for plotly.

    Args:
        title: title with unit.
        more: further keys of plotly's axis.
    """
    return {**_AXIS, "title": {"text": title, "standoff": 6}, **more}


def layout_of(height: int, **more: object) -> dict[str, Any]:
    """Return the layout that all figures share.

    Args:
        height: height of the figure [px].
        more: further keys of plotly's layout.
    """
    return {
        "height": height, "margin": {"l": 56, "r": 12, "t": 24, "b": 40},
        "font": {"family": palette.FONT, "size": 12},
        "paper_bgcolor": "#fff", "plot_bgcolor": "#fff", "hovermode": "closest",
        "legend": {"orientation": "h", "x": 0, "y": 1.01, "yanchor": "bottom"}, **more,
    }  # fmt: skip


ERROR = (
    "Root mean square of measured minus predicted effort in runs that were not used for the fit: each run is "
    "predicted from the others."
)
NOISE_LEVEL = "The error that noise alone would leave if no effect were missing, or an upper bound of it."
ROUGH = "preview, refining …"
FALL = "Error in held-out runs, one bar for each effect added; the green line is the noise."
CURVES = "Blue: measured; gray: base model; orange: chosen model. Below: measured minus model."
STATE = "Curves over position and over velocity: loops show damping or friction, bends show stiffness."
MAP = (
    "Mean of measured minus model over position and velocity: red above, blue below; a good model is pale. "
    "A cell with one or two samples shows the mean of its block of neighboring cells."
)
BUDGET = f"Shares of the base model's squared error in held-out runs, by kind of effect. {RANGE_MEANING}"
STALE = "This result is for the effects that were ticked before; the new one is being computed."
EVIDENCE = (
    "Share of the error in held-out runs that this effect removes if the other ticked effects are already "
    "in the model."
)
ALIKE = (
    "After a diagnosis: effects that it cannot tell apart. Before a diagnosis: effects that change the model "
    "in nearly the same way (cosine above 0.95); a diagnosis may still tell them apart."
)
INTERVAL = "95 % interval: if the model is right, 19 of 20 experiments like this one give a value within it."
SLIDER = "Drag to see the curves at another value; other parameters keep their values, and nothing is fitted."
SAME = "Copy these lines to get exactly this fit on the command line or in Python."
STOP = "End the diagnosis; nothing is changed."
BACK = "Reset the sliders to the fitted values."
HOLD = "Keep this parameter at this value, and fit the others again."
BOUND = "Fit again; if the fitted value is outside the bounds, the parameter is held at the nearer bound."
RUNS = "Which runs are drawn. All are fitted; a run's held-out error comes from a fit to the other runs."
LEFT_OUT = "Runs left out: they are neither fitted nor scored until they are put back."
HELD_OUT = (
    "Runs excluded from fitting: the error is measured only in these. If there are none, each "
    "run is predicted from the others."
)
CURSORS = "Click on the curves to set cursor A or B, or type a time: values and differences are read there."
KEEP = "Save the chosen effects as a revision, as palpate add does; you can go back to it at any time."
NOT_KEPT = ": a new fit of all parameters, without your slider values, held values and bounds"
REVISIONS = "Models of these runs that were saved here or by a command; choose one to go back to it."
GATES = "Data are checked before fitting, because a fit to unsuitable data gives wrong parameters."
DIAGNOSE = (
    "Show which kinds of effects make up the error and which effects are missing; takes a while, "
    "and can be stopped."
)
VERDICTS = {
    "adequate": "These data show no missing effect.",
    "missing": "These effects are missing; the form of each is exact unless it is marked as approximate.",
    "unexplained": "Something is missing, but no effect in the library explains it.",
    "insufficient": "No verdict is possible with these data; the reason says what to record.",
}
GATE = {
    "enough": "enough data: samples and runs, including runs to hold out",
    "units": "units and times are consistent",
    "sync": "effort and motion agree in time and sign",
    "excitation": "excitation: the object is touched, and the signals change",
    "readings": "readings: the resolution is fine enough, and no signs were lost",
    "saturation": "the sensor is not saturated",
}
EFFECTS = "Physical causes that the base model lacks; tick one to add it, untick it to remove it."
PICTURE = "What the effect looks like: gray without it, orange with it. Click for live sliders."
RESOLVE = (
    "Probes, diagnoses, and repeats with the experiment that best separates the remaining explanations; see "
    "palpate resolve."
)
DESIGNING = "Simulating the arm's experiments to find the most informative one; this takes up to two minutes."
SEALED = (
    "The session does not contain its simulated world, perhaps because the hidden effects are not revealed "
    "yet. Probe again with the same options, or begin with palpate resolve."
)
