"""Checks before fitting: whether a recording can be judged, and what in it is implausible."""

from palpate.estimation.data_quality.checks import (
    SINGLE_RUN,
    checklist,
    contaminated,
    quality_warnings,
    reject_reason,
    usable,
)

__all__ = [
    "SINGLE_RUN",
    "checklist",
    "contaminated",
    "quality_warnings",
    "reject_reason",
    "usable",
]
