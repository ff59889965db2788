"""Estimators by family; a new one is one new class here."""

from estimation.estimator import Estimator
from robot_io.registry import Registry

ESTIMATORS: Registry[Estimator] = Registry("estimator", Estimator, "estimation.estimators")  # type: ignore[type-abstract]
