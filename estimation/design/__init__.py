"""Which experiment would tell explanations apart that the data so far do not."""

from estimation.design.choice import Choice, Experiment, choose
from estimation.design.discrimination import CLEAR, Rivals

__all__ = ["CLEAR", "Choice", "Experiment", "Rivals", "choose"]
