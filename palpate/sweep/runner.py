"""Runs the cases of a sweep on the cores of this machine or on dask workers; nothing finished is repeated.

The worker that worked a case out puts the result into the store before it says that it is done. Whoever is
killed, client, scheduler or worker, the cases that were just running are all that is lost.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from palpate.sweep.case import Case, code_version
from palpate.sweep.store import ResultStore
from palpate.sweep.worker_pool import run_in_processes
from robot_io.errors import InputError, PalpateError, describe_error

_AHEAD = 500  # cases that the scheduler knows of at a time
_PACK_EVERY = 500
_JOIN_S = 10.0  # for a scheduler to answer, and to have a worker

Progress = Callable[[int, int], None]  # cases that are done, and all of them


@dataclass(frozen=True)
class Cluster:
    """Where cases run."""

    # Address of a dask scheduler, such as "tcp://10.0.0.5:8786"; None for processes on this machine.
    scheduler: str | None = None
    workers: int | None = None  # processes on this machine; None for one a core


@dataclass(frozen=True)
class SweepReport:
    """What became of the cases."""

    finished_before: int  # results that were there already
    finished_now: int  # worked out by this call
    # One line for each case without a result, such as one that ended its worker again and again.
    failures: tuple[str, ...]
    wall_s: float  # time of this call [s]


def run_cases(
    cases: Sequence[Case],
    store: ResultStore,
    cluster: Cluster = Cluster(),
    progress: Progress = lambda _done, _total: None,
) -> SweepReport:
    """Work out all cases that have no result yet.

    A case whose work raises has a result: a row that says so in its column `error`. Every row also has the
    case's `seed`, in `seconds` the processor time that the case took, and whether it is the case's `first`.

    Raises:
        InputError: there is no such scheduler, it has no workers, they do not see the store's folder, or run
            other code.
        PalpateError: the scheduler was lost; the same call goes on from there.
    """
    begun_s = time.perf_counter()
    finished = store.finished()
    todo = {case.address: case for case in cases}
    total = len(todo)
    todo = {address: case for address, case in todo.items() if address not in finished}
    before = total - len(todo)
    progress(before, total)
    failures: list[str] = []
    now = 0
    for failure in _run(cluster, todo, store):
        failures += [failure] if failure else []
        now += not failure
        progress(before + now + len(failures), total)
        if now % _PACK_EVERY == 0:
            store.pack()
    store.pack()
    return SweepReport(before, now, tuple(failures), time.perf_counter() - begun_s)


def run_one(case: Case, address: str, folder: Path) -> None:
    """What a worker does with a case: work it out and let the result land.

    Raises:
        PalpateError: this worker's code is not the client's, as of one that joined later.
    """
    if case.address != address:
        raise PalpateError("a worker runs another version of palpate or of its libraries")
    begun_s = time.process_time()
    try:
        rows, error = case.run(), ""
    except Exception as problem:  # a result as well: the same case would fail again
        rows, error = [{}], str(problem) if isinstance(problem, PalpateError) else describe_error(problem)
    common = {"seed": case.seed, "seconds": time.process_time() - begun_s, "error": error}
    landing = [row | common | {"first": number == 0} for number, row in enumerate(rows)]
    ResultStore(folder).land(address, landing)


def _run(cluster: Cluster, todo: dict[str, Case], store: ResultStore) -> Iterator[str]:
    """An empty text for each case that lands, and for any other why it does not."""
    folder = store.folder.absolute()
    if not todo:
        return
    if cluster.scheduler is None:
        yield from run_in_processes(run_one, todo, folder, cluster.workers or os.cpu_count() or 1)
        return
    with _client(cluster.scheduler) as client:
        _check_workers(client, store, {case.work.partition(":")[0] for case in todo.values()})
        yield from _run_on_dask(client, todo, folder)


def _run_on_dask(client: Any, todo: dict[str, Case], folder: Path) -> Iterator[str]:  # noqa: ANN401, dask's
    """The same as `_run`, by the workers of a scheduler."""
    from distributed import as_completed  # noqa: PLC0415, takes half a second

    waiting = iter(todo.items())
    mark = uuid4().hex[:8]  # a key of an earlier client may still be running

    def submit(address: str, case: Case) -> Any:  # noqa: ANN401
        return client.submit(run_one, case, address, folder, key=f"case-{address}-{mark}", pure=False)

    pending = as_completed([submit(*one) for one in islice(waiting, _AHEAD)])
    for future in pending:
        problem = future.exception() if future.status == "error" else None
        if future.status in ("cancelled", "lost") or isinstance(problem, CancelledError):
            raise PalpateError(
                f"the scheduler {client.scheduler.addr if client.scheduler else ''} is gone; what is "
                "finished is kept, and the same command goes on from there"
            )
        address = future.key.split("-")[1]
        yield f"case {dict(todo[address].parameters)}: {problem}" if problem else ""
        for one in islice(waiting, 1):
            pending.add(submit(*one))


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """A client of a dask scheduler that has workers."""
    from distributed import Client  # noqa: PLC0415, as above

    try:
        client = Client(scheduler, timeout=_JOIN_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"scheduler {scheduler}: does not answer ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_JOIN_S)
        except TimeoutError:
            raise InputError(f"scheduler {scheduler}: has no workers (dask worker ADDRESS)") from None
        yield client


def _check_workers(client: Any, store: ResultStore, modules: set[str]) -> None:  # noqa: ANN401
    """Refuse workers that do not write into this folder, or whose results would be of other code."""
    mark = store.folder.absolute() / f".seen-by-all-{uuid4().hex}"
    mark.touch()
    try:
        seen = client.run(_look, mark, sorted(modules))
    finally:
        mark.unlink()
    ours = _look(mark, sorted(modules))[1]
    for worker, (is_there, versions) in seen.items():
        if not is_there:
            raise InputError(f"worker {worker}: does not see {mark.parent}; --out must be on a shared disk")
        if versions != ours:
            raise InputError(f"worker {worker}: runs another version of palpate or of its libraries")


def _look(mark: Path, modules: list[str]) -> tuple[bool, list[str]]:
    return mark.is_file(), [code_version(module) for module in modules]
