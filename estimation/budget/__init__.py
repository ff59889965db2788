"""Error budget: how much of a model's error each kind of effect accounts for."""

from palpate.estimation.budget.budget import BudgetEntry, ErrorBudget, error_budget
from palpate.estimation.budget.held_out import HeldOutError

__all__ = ["BudgetEntry", "ErrorBudget", "HeldOutError", "error_budget"]
