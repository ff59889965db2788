"""The page of two sides: one file that needs nothing else, and no network."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from markupsafe import Markup
from plotly.offline import get_plotlyjs

from estimation.estimate import ParameterEstimate
from palpate.render import sides_figures
from palpate.render.page import rendered
from palpate.render.report import as_html
from palpate.render.sides import LETTERS, PairView, SidesView, difference_text
from palpate.words import significant

_TEMPLATE = Path(__file__).parent / "sides.html"


def document(pair: PairView) -> str:
    """The whole page."""
    filters: dict[str, Callable[..., Any]] = {
        "value": _value,
        "difference": difference_text,
    }
    facts = dict(zip(LETTERS, pair.names, strict=True))
    facts |= {"models": ", ".join(dict.fromkeys(side.model for one in pair.channels for side in one.pair))}
    plotly = Markup(get_plotlyjs())  # noqa: S704, plotly's own
    return rendered(_TEMPLATE, filters, title=pair.title, facts=facts, pair=pair, plotly=plotly, plots=_plots)


def _plots(view: SidesView) -> dict[str, Markup]:
    draw = {
        "state": sides_figures.state_figure,
        "time": sides_figures.time_figure,
        "residual": sides_figures.residual_figure,
    }
    return {name: as_html(figure(view)) for name, figure in draw.items()}


def _value(one: ParameterEstimate | None) -> str:
    return "–" if one is None else significant(one.value, one.std_err)
