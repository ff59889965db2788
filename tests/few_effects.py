"""A small effect library and a short error budget, for tests around a diagnosis.

The search and the budget have tests of their own.
"""

import pytest

from palpate.estimation.budget import budget, held_out
from palpate.estimation.effects import EFFECTS
from palpate.estimation.study import fits

FEW = (
    *("cubic_stiffness", "quadratic_damping", "bias", "stress_relaxation", "stiffness"),
    *("coulomb_friction", "viscous_friction", "run_gain", "recorded_dependence"),
)


def try_few_effects(patch: pytest.MonkeyPatch, *more: str, few: tuple[str, ...] = FEW) -> None:
    """Studies that are made from now on know no other effects but `few` and `more`, beside the user's own."""
    patch.setattr(fits, "effect_library", lambda: tuple(EFFECTS[name]() for name in (*few, *more)))
    shorten_budget(patch)


def shorten_budget(patch: pytest.MonkeyPatch) -> None:
    """Error budgets that are made from now on try one ridge penalty instead of three, and sets of 3 kinds."""
    patch.setattr(held_out, "_RIDGES", (1e-4,))
    patch.setattr(budget, "_MAX_KINDS", 3)
