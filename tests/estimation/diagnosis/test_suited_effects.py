"""Forms of effects that suit a channel are created once."""

from dataclasses import replace

import numpy as np

from palpate.estimation.diagnosis.suited_effects import forms_of, suited_effect
from palpate.estimation.effects import EFFECTS
from tests.estimation.swings import long_swings


def with_load(data, load):
    return replace(data, context={**data.context, "load": load})


def test_effect_is_suited_once_to_a_channel_with_any_load():
    """A search compares models with other loads, and looks columns up by the effect."""
    data, effect = long_swings(1, runs=1), EFFECTS["bouc_wen_hysteresis"]()
    first = suited_effect(effect, with_load(data, np.zeros(len(data))))
    assert suited_effect(effect, with_load(data, np.ones(len(data)))) is first
    assert first.inner[0].lower == effect.suited_to(data).inner[0].lower


def test_effect_is_suited_again_to_another_channel_or_other_signals():
    data, effect = long_swings(1, runs=1), EFFECTS["bouc_wen_hysteresis"]()
    first = suited_effect(effect, data)
    assert suited_effect(effect, replace(data, effort=data.effort.copy())) is not first
    assert suited_effect(effect, with_load(data, np.zeros(len(data)))) is not first
    assert suited_effect(EFFECTS["bouc_wen_hysteresis"](), data) is not first


def test_effect_that_needs_the_load_is_suited_to_each_load():
    data, effect = long_swings(1, runs=1), EFFECTS["load_dependent_presliding"]()
    loads = [with_load(data, load * np.ones(len(data))) for load in (1.0, 2.0)]
    assert suited_effect(effect, loads[0]) is not suited_effect(effect, loads[1])


def test_forms_are_created_once():
    effect = EFFECTS["joint_elasticity"]()
    forms = forms_of(effect)
    assert [form.form for form in forms] == [form.form for form in effect.forms()]
    assert forms_of(effect) is forms
