"""Which experiment would tell explanations apart that the data so far do not."""

from estimation.design.choice import Choice, Experiment, choose
from estimation.design.discrimination import Rivals

__all__ = ["Choice", "Experiment", "Rivals", "choose"]
