"""Checks before fitting: reject recordings that cannot be judged, warn of what is implausible."""

from palpate.estimation.data_quality.checks import (
    checklist,
    contaminated,
    quality_warnings,
    reject_reason,
    usable,
)
from palpate.estimation.data_quality.extent import SINGLE_RUN

__all__ = ["SINGLE_RUN", "checklist", "contaminated", "quality_warnings", "reject_reason", "usable"]
