"""One self-contained HTML file that says what was found, and can be zoomed into."""

from palpate.report.report import Report
from palpate.report.write import write_report

__all__ = ["Report", "write_report"]
