"""A model with one more effect is fitted from every start that may lead to another minimum."""

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.diagnosis import extension
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.models import MODELS
from tests.estimation.presses import kelvin_voigt, session
from tests.estimation.searches import SWING
from tests.estimation.swings import DAMPING, swings

BASE = MODELS["kelvin_voigt"]().build(ModelContext())
TRANSITION = "coulomb_friction.transition"


def stiffening(t, x, v, run):
    return kelvin_voigt(x, v) + 2e6 * np.maximum(x, 0.0) ** 3


@pytest.mark.parametrize(
    ("name", "law", "fits"),
    [
        ("cubic_stiffness", stiffening, 1),
        ("cubic_stiffness", None, 2),  # no better than the model without it: tried once more
        ("relaxation_spectrum", None, 4),
    ],
)
def test_fit_with_least_held_out_error_is_selected(name, law, fits, monkeypatch):
    data, made = session(1, *([law] if law else [])), []

    def recorded(*given):
        made.append(fit_model(*given))
        return made[-1]

    base = fit_model(data, BASE, {})
    monkeypatch.setattr(extension, "fit_model", recorded)
    found = extension.fit_extended(data, base, EFFECTS[name]())
    assert len(made) == fits
    assert found.solution is min(made, key=lambda fit: fit.solution.held_out).solution
    if name == "relaxation_spectrum":
        assert np.ptp([fit.solution.parameters["relaxation_spectrum.slow_time"] for fit in made]) > 0.0


def test_earlier_effect_at_its_bound_is_refitted_beside_the_added_one():
    """Alone, Coulomb friction takes most of a quadratic friction by a transition at the end of its range."""
    data = swings(3, lambda q, v, a: 0.3 * v * np.abs(v) + 0.3 * np.sign(v) - DAMPING * v)
    coulomb, quadratic = EFFECTS["coulomb_friction"](), EFFECTS["quadratic_friction"]()
    parent = fit_model(data, SWING.without("viscous_friction").with_effect(coulomb), {TRANSITION: 900.0})
    assert parent.values[TRANSITION] > 990.0
    values = extension.fit_extended(data, parent, quadratic).values
    assert values["coulomb_friction.force"] == pytest.approx(0.3, rel=0.05)
    assert values["quadratic_friction.d2"] == pytest.approx(0.3, rel=0.05)
