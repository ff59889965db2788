"""Run many cases of one kind on several cores or machines, and store each result by its content address.

`palpate sweep` runs a sweep. A `Study`, by contrast, is one measurement with its models.
"""

from palpate.sweep.case import RESULTS, Case, ResultStore, refuse_other_files
from palpate.sweep.runner import Cluster, run_cases

__all__ = ["RESULTS", "Case", "Cluster", "ResultStore", "refuse_other_files", "run_cases"]
