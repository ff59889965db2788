"""Model against measurement."""

from estimation.comparison.compare import Comparison, Part, compare, compare_standing

__all__ = ["Comparison", "Part", "compare", "compare_standing"]
