"""Estimators, one per file."""

from estimation.estimators.registry import ESTIMATORS

__all__ = ["ESTIMATORS"]
