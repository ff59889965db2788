"""Choose the experiment that separates explanations which the present data do not separate."""

from palpate.estimation.design.discrimination import Choice, Experiment, Rivals, choose

__all__ = ["Choice", "Experiment", "Rivals", "choose"]
