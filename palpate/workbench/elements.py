"""Elements of the page, and the sentences shown on hover.

Texts may come from files: each is one property, never a part of code or markup.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import nicegui.elements.plotly  # noqa: F401, serves plotly.js; plotly's Python, which it also has, is slow to import
from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

AnyElement = TypeVar("AnyElement", bound=Element)


def set_props(element: AnyElement, **values: str | bool) -> AnyElement:
    """Set properties by key (aria_label sets aria-label); returns the element.

    `Element.props("key=value")` reads its text as code: a quote in a value would begin properties of its own.
    """
    element.props.update({key.replace("_", "-"): value for key, value in values.items()})
    return element


def heading(text: str, title: str = "") -> None:
    """A heading; `title` is shown on hover."""
    element = TextElement(tag="h2", text=text)
    if title:
        set_props(element, title=title)


Figure = dict[str, Any]
Restyle = tuple[Mapping[str, Sequence[Any]], list[int]]


class Plot(Element, component="plot.js"):
    """One figure; what changes before the browser is ready for it is sent when it is."""

    def __init__(self, figure: Figure) -> None:
        super().__init__()
        self.figure: Figure = figure
        self._props["figure"] = figure
        self._is_ready = False
        self.on("ready", self._send_figure)

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

    def _send_figure(self) -> None:
        self._is_ready = True
        self._send("replace", self.figure)


ERROR = (
    "Root mean square of measured minus predicted effort in runs that the gains were not fitted to: "
    "each run is predicted from the others."
)
NOISE_LEVEL = (
    "The error that would be left if nothing were missing, estimated by a flexible regression; noise alone."
)
ROUGH = "first look, refining …"
FALL = "Error in held-out runs, one bar for each effect added; the green line is the noise level."
CURVES = (
    "Blue is measured, grey the base model, orange the model that is chosen; below, measured minus model."
)
STATE = "The same curves over position and over velocity: loops are damping or friction, bends are stiffness."
MAP = "Mean of measured minus model over position and velocity: red above, blue below; a good model is pale."
BUDGET = (
    "Shares of the base model's squared error in held-out runs, by kind of effect. Ranges: from what only "
    "this kind explains to what it explains alone."
)
EVIDENCE = (
    "How much of the held-out error this effect takes away, or took, beside the others that are ticked."
)
ALIKE = "What these change has a cosine above 0.95; a diagnosis says whether this data can tell them apart."
INTERVAL = (
    "95 % interval: an experiment like this one gives values within it 19 times of 20, if the model is right."
)
SLIDER = (
    "Pull to see the curves at another value, the other parameters as they are; nothing is fitted meanwhile."
)
SAME = "The command line and Python give this fit, number for number; copy these lines."
STOP = "End the diagnosis; nothing is changed."
BACK = "Put the sliders back to the fitted values."
HOLD = "Keep this parameter at this value, and fit the others again."
BOUND = "Fit again; if the parameter would leave the bounds, it is held at the nearer one."
RUNS = (
    "Which runs are drawn. All are fitted, and each is predicted without itself: that is its held-out error."
)
LEFT_OUT = "Runs that are taken out: they are neither fitted nor judged, until they are put back."
HELD_OUT = (
    "Runs that no model is fitted to: the error is measured in these alone. Without any, each run is "
    "predicted from the others."
)
CURSORS = "Click into the curves to set cursor A or B, or type a time: values and differences are read there."
KEEP = "Keep the chosen effects as a revision, as palpate add does; go back to it at any time."
REVISIONS = "Models that were kept, here or by the command line; choose one to go back to it."
GATES = "Checked before anything is fitted: a fit of such data would only look like an answer."
DIAGNOSE = (
    "Say what kinds of effects the error is made of and which effects are missing; takes a while, and can be "
    "stopped."
)
VERDICTS = {
    "adequate": "Nothing is missing that this data can show.",
    "missing": "These effects are missing; the form of each is exact, or marked as approximate.",
    "unexplained": "Something is missing; no effect in the library has its form.",
    "insufficient": "This data cannot say; the reason says what to record.",
}
GATE = {
    "enough": "enough data: samples, runs, and something to hold out",
    "units": "units and times belong together",
    "sync": "effort and motion belong together in time and sign",
    "excitation": "excitation: the object is met, and the signals change",
    "readings": "readings: fine enough, and not rectified",
    "saturation": "not at the end of the sensor's range",
}
EFFECTS = "Physical causes that the base model lacks; tick one to add it, and again to take it away."
PICTURE = "What it looks like: grey without, orange with it. Click for live sliders."
RESOLVE = (
    "Probes, diagnoses, and probes again in the way that best tells apart what is left; see palpate resolve."
)
DESIGNING = "Rehearsing what the arm can do, to find what tells most: up to a minute or two."
SEALED = (
    "The session does not say in which world it was probed (what is hidden there may be sealed): probe again "
    "with the options of then, or begin with palpate resolve."
)
