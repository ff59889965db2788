"""The estimators of contact laws that palpate knows; a new one is one new file in this folder."""

from estimation.contact_estimator import ContactEstimator
from robot_io.registry import Registry

CONTACT_ESTIMATORS: Registry[ContactEstimator] = Registry(
    "contact estimator",
    ContactEstimator,  # type: ignore[type-abstract]
    "estimation.contact_estimators",
)
