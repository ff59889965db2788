"""Estimates with standard uncertainties that hold for few observations too."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from scipy.stats import norm, t

_COVERED = 0.975
Value = TypeVar("Value")


@dataclass(frozen=True)
class UncertainValue(Generic[Value]):
    """A value (or an array of them) and its standard uncertainty."""

    value: Value
    std_err: Value


def few_sample_factor(degrees_of_freedom: int) -> float:
    """Compute the factor with which twice a standard error estimated from few samples covers about 95 %.

    Student's t over the normal quantile: 1 for many and 1.2 for 7 degrees of freedom. Source: "Guide to the
    expression of uncertainty in measurement" (JCGM 100:2008), G.3.

    Args:
        degrees_of_freedom: of the estimated standard error.

    Returns:
        The factor.
    """
    return float(t.ppf(_COVERED, degrees_of_freedom) / norm.ppf(_COVERED))
