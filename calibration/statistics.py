"""Estimates with standard uncertainties that mean the same however few observations they rest on."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from scipy.stats import norm, t

_COVERED = 0.975
Value = TypeVar("Value")


@dataclass(frozen=True)
class Estimate(Generic[Value]):
    """A value (or an array of them) and its standard uncertainty."""

    value: Value
    std_err: Value


def few_sample_factor(degrees_of_freedom: int) -> float:
    """Factor on a standard error with which twice of it covers about 95 % although it was estimated.

    Student's t over the normal quantile; see "Guide to the expression of uncertainty in measurement" (JCGM
    100:2008), G.3. It is 1 for many and 1.2 for 7 degrees of freedom.
    """
    return float(t.ppf(_COVERED, degrees_of_freedom) / norm.ppf(_COVERED))
