"""A model with one more effect is fitted from every start that may lead to another minimum."""

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.diagnosis import extension
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.models import MODELS
from tests.estimation.presses import session

BASE = MODELS["kelvin_voigt"]().build(ModelContext())


@pytest.mark.parametrize(("name", "fits"), [("cubic_stiffness", 1), ("relaxation_spectrum", 4)])
def test_of_fits_from_several_starts_the_one_counts_that_leaves_least_held_out(name, fits, monkeypatch):
    data, made = session(1), []

    def recorded(*given):
        made.append(fit_model(*given))
        return made[-1]

    base = fit_model(data, BASE, {})
    monkeypatch.setattr(extension, "fit_model", recorded)
    found = extension.fit_extended(data, base, EFFECTS[name]())
    assert len(made) == fits
    assert found.solution is min(made, key=lambda fit: fit.solution.held_out).solution
    if fits > 1:
        assert np.ptp([fit.solution.parameters["relaxation_spectrum.slow_time"] for fit in made]) > 0.0
