"""Estimators of contact laws; a new one is one new class here."""

from estimation.contact_estimator import ContactEstimator
from robot_io.registry import Registry

CONTACT_ESTIMATORS: Registry[ContactEstimator] = Registry(
    "contact estimator",
    ContactEstimator,  # type: ignore[type-abstract]
    "estimation.contact_estimators",
)
