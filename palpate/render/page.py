"""Pages from templates: each stands alone, with its style inside."""

from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

_HERE = Path(__file__).parent
_STYLE = _HERE / "report.css"
_HEAD, _MARK = 200, b'<meta name="generator" content="palpate '  # of every page, see base.html


def is_own_page(path: Path) -> bool:
    """Whether a file is a page that palpate made."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return _MARK in file.read(_HEAD)


def rendered(template: Path, filters: Mapping[str, Callable[..., Any]], **values: object) -> str:
    """The page that a template makes of values; `style` and `version` are given to all.

    A template extends base.html, which wants a `title` and `facts`.
    """
    environment = Environment(
        loader=FileSystemLoader([template.parent, _HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters
    style = Markup(_STYLE.read_text(encoding="utf-8"))  # noqa: S704, our own
    return environment.get_template(template.name).render(**values, style=style, version=version("palpate"))
