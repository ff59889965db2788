"""Model against measurement."""

from estimation.comparison.compare import Comparison, Part, compare

__all__ = ["Comparison", "Part", "compare"]
