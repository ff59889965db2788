"""Run many cases of one kind on cores and machines, each result stored at its content address.

A sweep is what `palpate sweep` runs. It is not a `Study`: that is one measurement with its models.
"""

from palpate.sweep.case import Case, ResultStore
from palpate.sweep.runner import Cluster, run_cases

__all__ = ["Case", "Cluster", "ResultStore", "run_cases"]
