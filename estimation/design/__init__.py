"""Which experiment would tell explanations apart that the data so far do not."""

from palpate.estimation.design.discrimination import Choice, Experiment, Rivals, choose

__all__ = ["Choice", "Experiment", "Rivals", "choose"]
