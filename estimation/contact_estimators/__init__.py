"""Estimators of contact laws; add a class in this folder to register a new one."""

from palpate.estimation.estimator import ContactEstimator
from palpate.robot_io.registry import Registry

CONTACT_ESTIMATORS: Registry[ContactEstimator] = Registry(
    "contact estimator",
    ContactEstimator,  # type: ignore[type-abstract]
    "palpate.estimation.contact_estimators",
)
