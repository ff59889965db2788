"""Estimators of contact laws; a new one is one new class here."""

from palpate.estimation.contact_estimator import ContactEstimator
from palpate.robot_io.registry import Registry

CONTACT_ESTIMATORS: Registry[ContactEstimator] = Registry(
    "contact estimator",
    ContactEstimator,  # type: ignore[type-abstract]
    "palpate.estimation.contact_estimators",
)
