"""Cases of a sweep, worked out for a script."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from palpate.render.progress import sweep_progress
from palpate.sweep import Case, Cluster, ResultStore, run_cases

Row = Mapping[str, Any]


def worked_out(cases: Sequence[Case], results: Path | None, cluster: Cluster) -> list[list[Row]]:
    """Rows of each case; those that are in the folder of results already are not repeated."""
    with ExitStack() as stack:
        store = ResultStore(results or Path(stack.enter_context(TemporaryDirectory())))
        run_cases(cases, store, cluster, stack.enter_context(sweep_progress()))
        rows = [store.rows([case.address]) for case in cases]
    for row in (row for of_case in rows for row in of_case if row["error"]):
        raise SystemExit(row["error"])
    return rows
