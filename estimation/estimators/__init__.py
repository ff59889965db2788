"""Estimators by family; a new one is a new class in this folder."""

from palpate.estimation.estimator import Estimator
from palpate.robot_io.registry import Registry

ESTIMATORS: Registry[Estimator] = Registry("estimator", Estimator, "palpate.estimation.estimators")  # type: ignore[type-abstract]
