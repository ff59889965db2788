"""Error budgets that try few combinations, except in tests that ask for the whole budget."""

import pytest

from tests.few_effects import shorten_budget


@pytest.fixture
def whole_budget():
    """All combinations are tried."""


@pytest.fixture(autouse=True)
def short_budget(request, monkeypatch):
    """Try few combinations of kinds, unless a test asks for the whole budget."""
    if "whole_budget" not in request.fixturenames:
        shorten_budget(monkeypatch)
