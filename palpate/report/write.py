"""Puts the sections into one file that needs nothing else, and no network."""

from html import escape
from importlib.metadata import version
from pathlib import Path

from plotly.offline import get_plotlyjs

from palpate.files import write_text
from palpate.report.report import Report
from palpate.report.section import in_order

# Whatever a page like this contains, the browser fetches nothing.
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
STYLE = (Path(__file__).parent / "report.css").read_text(encoding="utf-8")


def write_report(report: Report, path: Path) -> Path:
    """Write the report; the file appears whole or not at all.

    Args:
        report: what to tell.
        path: the .html file, replaced if it is there.

    Raises:
        InputError: it cannot be written.
    """
    write_text(path, document(report))
    return path


def document(report: Report) -> str:
    """The whole page."""
    told = [(section, section.html(report)) for section in in_order()]
    told = [(section, body) for section, body in told if body]
    links = "".join(f'<a href="#{section.name}">{section.title}</a>' for section, _ in told)
    bodies = "".join(
        f'<section id="{section.name}"><h2>{section.title}</h2>{body}</section>' for section, body in told
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>palpate: {escape(report.file)}</title><style>{STYLE}</style>"
        f"<script>{get_plotlyjs()}</script></head><body><main>"
        f"<header><h1>{escape(report.file)}</h1>{_facts(report)}<nav>{links}</nav></header>"
        f"{bodies}<footer>palpate {escape(version('palpate'))}</footer></main></body></html>\n"
    )


def _facts(report: Report) -> str:
    facts = "".join(
        f"<span><b>{escape(name)}</b> {escape(value)}</span>" for name, value in report.facts.items()
    )
    return f'<p class="facts">{facts}</p>'
