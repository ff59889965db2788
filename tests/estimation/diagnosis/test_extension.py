"""A model with one more effect is fitted from every start that may lead to another minimum."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from palpate.estimation.base_model import ModelContext
from palpate.estimation.diagnosis import extension
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.models import MODELS
from tests.estimation.presses import kelvin_voigt, session
from tests.estimation.searches import SWING
from tests.estimation.swings import DAMPING, swings

BASE = MODELS["kelvin_voigt"]().build(ModelContext())
TRANSITION = "coulomb_friction.transition"


def low_pass(signal, t, tau):
    """First-order low-pass of one run with a constant step."""
    half = 0.5 * (t[1] - t[0]) / tau
    a, b = [1.0 + half, half - 1.0], [half, half]
    return scipy.signal.lfilter(b, a, signal, zi=scipy.signal.lfilter_zi(b, a) * signal[0])[0]


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


@pytest.mark.parametrize(("is_physical", "starts"), [(True, [0]), (False, [0, 2, 4, 6])])
def test_unphysical_fit_is_repeated_from_the_best_physical_starts(is_physical, starts, monkeypatch):
    base, made = fit_model(session(1), BASE, {}), []
    solutions = [
        SimpleNamespace(parameters={"number": number}, sse=float(number), is_physical=number % 2 == 0)
        for number in (8, 6, 5, 4, 3, 2, 1)
    ]
    best = SimpleNamespace(parameters={"number": 0}, model=base.model, is_physical=is_physical)
    search = SimpleNamespace(best=best, starts=solutions)
    monkeypatch.setattr(extension, "screen_effects", lambda *_: [SimpleNamespace(search=search)])
    monkeypatch.setattr(extension, "fit_model", lambda data, model, start, *_: made.append(start) or base)
    extension.fit_extended(base.data, base, EFFECTS["cubic_stiffness"]())
    assert [start["number"] for start in made] == starts


@pytest.mark.parametrize("transition", [10.0, 900.0])  # beyond all speeds; at the end of its range
def test_earlier_effect_is_refitted_beside_the_added_one(transition):
    """Alone, Coulomb friction takes most of a quadratic friction by a wide transition."""
    data = swings(3, lambda q, v, a: 0.3 * v * np.abs(v) + 0.3 * np.sign(v) - DAMPING * v)
    coulomb, quadratic = EFFECTS["coulomb_friction"](), EFFECTS["quadratic_friction"]()
    fit = fit_model(data, SWING.without("viscous_friction").with_effect(coulomb), {TRANSITION: 900.0})
    values = {**fit.values, TRANSITION: transition}
    parent = FitResult(fit.data, fit.problem, solve_gains(fit.problem, fit.model, values))
    values = extension.fit_extended(data, parent, quadratic).values
    assert values["coulomb_friction.force"] == pytest.approx(0.3, rel=0.05)
    assert values["quadratic_friction.d2"] == pytest.approx(0.3, rel=0.05)


def test_other_form_is_tried_after_the_joint_fit():
    """Before the lag is refitted, friction of an object that only pushes fits better than at its sides."""
    data = session(
        3, lambda t, x, v, run: low_pass(kelvin_voigt(x, v) + np.tanh(v / 1e-3) * (x > 0.0), t, 0.05)
    )
    lag = extension.fit_extended(data, fit_model(data, BASE, {}), EFFECTS["lag"]())
    found = extension.fit_extended(data, lag, EFFECTS["dry_friction"]())
    assert found.values["lag.tau"] == pytest.approx(0.05, rel=0.02)
    assert found.values["dry_friction.force"] == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("name", ["dry_friction", "plastic_set"])
def test_each_form_lists_all_forms(name):
    forms = EFFECTS[name]().forms()
    assert len({form.form for form in forms}) == 2
    for form in forms:
        assert [type(other) for other in form.forms()] == [type(other) for other in forms]
