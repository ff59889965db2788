"""Estimators by family; add a class in this folder to register a new one."""

from palpate.estimation.estimator import Estimator
from palpate.robot_io.registry import Registry

ESTIMATORS: Registry[Estimator] = Registry("estimator", Estimator, "palpate.estimation.estimators")  # type: ignore[type-abstract]
