"""Choose the experiment that separates explanations which the present data do not separate."""

from palpate.estimation.design.discrimination import (
    Experiment,
    ExperimentChoice,
    RivalModels,
    choose_experiment,
)

__all__ = ["Experiment", "ExperimentChoice", "RivalModels", "choose_experiment"]
