"""The estimators that palpate knows; a new one is one new file in this folder."""

from estimation.estimator import Estimator
from robot_io.registry import Registry

ESTIMATORS: Registry[Estimator] = Registry("estimator", Estimator, "estimation.estimators")  # type: ignore[type-abstract]
