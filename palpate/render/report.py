"""The HTML report: one file that needs nothing else, and no network."""

import re
from collections.abc import Callable, Iterable
from html import escape
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import yaml
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from palpate.common.files import write_text
from palpate.common.formatting import chance
from palpate.render import figures
from palpate.render.budget import budget_picture
from palpate.render.page import rendered
from palpate.render.terminal import with_interval
from palpate.render.view import BudgetView, ChannelView, StudyView

_TEMPLATE = Path(__file__).parent / "report.html"
_BUDGET_WIDTH = 940  # [px]
_GREEK = {"tau": "τ", "mu": "μ", "pi": "π", "alpha": "α", "beta": "β", "omega": "ω"}


def write_report(view: StudyView, path: Path) -> Path:
    """Write the report; the file appears whole or not at all. InputError: it cannot be written."""
    write_text(path, document(view))
    return path


def document(view: StudyView) -> str:
    """The whole page."""
    filters: dict[str, Callable[..., Any]] = {
        "bold": bold, "typeset": typeset, "interval": with_interval, "chance": chance,
        "picture": _budget_picture,
        "yaml": lambda data: yaml.safe_dump(dict(data), sort_keys=False),
    }  # fmt: skip
    plotly = Markup(get_plotlyjs())  # noqa: S704, plotly's own
    return rendered(
        _TEMPLATE, filters, title=view.file, facts=view.facts, view=view, plotly=plotly, plots=_plots
    )


def _plots(channel: ChannelView) -> dict[str, Markup]:
    """The channel's figures as HTML, by name; empty where there is nothing to draw."""
    curves = {
        "fall": figures.fall_figure,
        "map": figures.map_figure,
        "time": figures.time_figure,
        "state": figures.state_figure,
    }
    wanted = dict.fromkeys(curves, bool(channel.stages)) | {"fall": bool(channel.fall)}
    wanted["time"] |= channel.wanted is not None
    return {name: as_html(draw(channel)) if wanted[name] else Markup() for name, draw in curves.items()}


def _budget_picture(budget: BudgetView) -> Markup:
    return Markup(budget_picture(budget, _BUDGET_WIDTH))  # noqa: S704, its texts are escaped


def as_html(figure: go.Figure) -> Markup:
    """A figure for a page that has plotly's program."""
    return Markup(figure.to_html(full_html=False, include_plotlyjs=False, config=figures.PLOT_CONFIG))  # noqa: S704, ours


def bold(sentence: str, names: Iterable[str]) -> Markup:
    """A sentence with names in bold, everything escaped."""
    text = escape(sentence)
    for name in dict.fromkeys(filter(None, names)):
        text = re.sub(rf"(?<![\w>]){re.escape(escape(name))}(?!\w)", f"<b>{escape(name)}</b>", text)
    return Markup(text)  # noqa: S704, escaped above


def typeset(equation: str) -> Markup:
    """Powers raised, numbers of symbols lowered, Greek letters as such, everything escaped."""
    raised = re.sub(r"\^(\([^)]*\)|[\w.]+)", r"<sup>\1</sup>", escape(equation, quote=False))
    lowered = re.sub(r"\b([A-Za-z])(\d)\b", r"\1<sub>\2</sub>", raised)
    greek = re.sub(rf"\b({'|'.join(_GREEK)})\b", lambda found: _GREEK[found[1]], lowered)
    return Markup(greek.replace("\n", "<br>"))  # noqa: S704, escaped above
