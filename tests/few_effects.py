"""A small library of effects, for tests of what is around a diagnosis; the search has tests of its own."""

import pytest

from palpate.estimation.effects import EFFECTS
from palpate.estimation.study import fits

FEW = (
    *("cubic_stiffness", "layered_stiffness", "stress_relaxation", "contact_offset", "bias", "lag"),
    *("stiffness", "damping", "quadratic_damping", "drift", "delay"),
    *("coulomb_friction", "viscous_friction", "weight"),
    *("run_gain", "run_offset", "recorded_dependence"),
)


def try_few_effects(patch: pytest.MonkeyPatch, *more: str) -> None:
    """Studies that are made from now on know no other effects but `more`, beside the user's own."""
    patch.setattr(fits, "effect_library", lambda: tuple(EFFECTS[name]() for name in (*FEW, *more)))
