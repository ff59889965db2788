"""Checks before fitting: reject unusable recordings and warn of implausible ones."""

from palpate.estimation.data_quality.checks import (
    checklist,
    contaminated,
    list_warnings,
    quality_warnings,
    reject_reason,
    usable,
)
from palpate.estimation.data_quality.readings import unchanging
from palpate.estimation.data_quality.sampling import SINGLE_RUN

__all__ = [
    "SINGLE_RUN",
    "checklist",
    "contaminated",
    "list_warnings",
    "quality_warnings",
    "reject_reason",
    "unchanging",
    "usable",
]
