"""Models fitted to a channel as a study fits them, for a given model."""

import numpy as np

from palpate.estimation.base_model import ModelContext
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.extension import fit_extended
from palpate.estimation.fit.measurement_noise import measurement_noise
from palpate.estimation.models import MODELS
from palpate.estimation.study import comparison
from palpate.estimation.study.fitting import fit_base
from tests.estimation.presses import kelvin_voigt

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def cubic(t, x, v, run):
    """A spring that stiffens."""
    return kelvin_voigt(x, v, 1.5e6 * np.maximum(x, 0) ** 3)


def fits(data, model, names=(), effects=None):
    """The base model, and one fit more for each effect that is added."""
    known = {effect.name: effect for effect in (effect_library() if effects is None else effects)}
    found = [fit_base(data, model)]
    for name in names:
        found.append(fit_extended(data, found[-1], known[name].suited_to(found[-1].data)))
    return found


def compare(data, model):
    """The model beside the measurement."""
    fitted = fit_base(data, model)
    return comparison.compare(fitted, fitted, model.name, measurement_noise(fitted))
