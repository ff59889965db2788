"""Choose the experiment that separates explanations which the data so far do not."""

from palpate.estimation.design.discrimination import Choice, Experiment, Rivals, choose

__all__ = ["Choice", "Experiment", "Rivals", "choose"]
