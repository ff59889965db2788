"""Estimators of contact laws, one per file."""

from estimation.contact_estimators.registry import CONTACT_ESTIMATORS

__all__ = ["CONTACT_ESTIMATORS"]
