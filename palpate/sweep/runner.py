"""Run the cases of a sweep in processes of this machine or on dask workers; nothing finished is repeated.

Processes of this machine communicate over pipes that no other program can open: no port listens.
"""

import os
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any
from uuid import uuid4

from threadpoolctl import threadpool_limits

from palpate.common.worker_process import start_worker
from palpate.estimation.workers import end_with_parent
from palpate.robot_io.errors import InputError, PalpateError, describe_error
from palpate.sweep.case import Case, ResultStore, code_version

_MOST_ENDS = 4  # number of workers that a case may kill before it is given up
_END_LIMIT_S = 5.0  # time limit for a worker's end

Run = Callable[[Case, str, Path], None]  # works out a case, by its address, for the store in a folder


def run_in_processes(run: Run, todo: Mapping[str, Case], folder: Path, workers: int) -> Iterator[str]:
    """Run all cases, by address; a worker that dies is replaced, and its case begins again.

    Args:
        run: does the work of a case.
        todo: cases by address.
        folder: folder of the results.
        workers: processes at a time.

    Yields:
        An empty text for each case that is done, and for any other why it is not.
    """
    waiting, ends = deque(todo), Counter[str]()
    pool = [_Worker.start(run, folder) for _ in range(min(workers, len(todo)))]
    idle, busy = list(pool), dict[object, tuple[_Worker, str]]()
    try:
        while waiting or busy:
            while waiting and idle:
                worker, address = idle.pop(), waiting.popleft()
                busy[worker.pipe] = worker, address
                worker.give(todo[address], address)
            for pipe in wait([worker.pipe for worker, _ in busy.values()]):
                worker, address = busy.pop(pipe)
                try:
                    problem = worker.pipe.recv()
                except (EOFError, OSError):  # it was killed, or the memory was full
                    pool.remove(worker)
                    pool.append(worker := _Worker.start(run, folder))
                    ends[address] += 1
                    problem = f"ended its worker {ends[address]} times"
                    if ends[address] < _MOST_ENDS:
                        waiting.append(address)
                        problem = None
                idle.append(worker)
                if problem is not None:
                    yield f"{todo[address].label}: {problem}" if problem else ""
    finally:
        for worker in pool:
            worker.process.terminate()
        for worker in pool:
            worker.process.join(_END_LIMIT_S)


@dataclass(frozen=True)
class _Worker:
    """A worker process with its pipe."""

    process: BaseProcess
    pipe: "Connection[tuple[Case, str], str]"

    @classmethod
    def start(cls, run: Run, folder: Path) -> "_Worker":
        """Start a process that waits for its first case.

        Args:
            run: does the work of a case.
            folder: folder of the results.
        """
        return cls(*start_worker(_serve, run, folder))

    def give(self, case: Case, address: str) -> None:
        """Send it a case; a dead worker is noticed when its answer is read.

        Args:
            case: the case.
            address: address of its result.
        """
        with suppress(OSError):
            self.pipe.send((case, address))


def _serve(pipe: "Connection[str, tuple[Case, str]]", run: Run, folder: Path) -> None:
    """Run cases as they come, and send an empty text or the error for each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    end_with_parent()
    with threadpool_limits(1):  # there is a worker for each core
        while True:
            case, address = pipe.recv()
            try:
                run(case, address, folder)
                pipe.send("")
            except PalpateError as error:
                pipe.send(str(error))
            except Exception as error:
                pipe.send(describe_error(error))


_AHEAD = 500  # number of cases submitted at a time
_PACK_EVERY = 500
_JOIN_S = 10.0  # time limit for the scheduler's answer and its first worker

Progress = Callable[[int, int], None]  # finished and total number of cases


@dataclass(frozen=True)
class Cluster:
    """Processes or machines on which cases run."""

    # Address of a dask scheduler, such as "tcp://10.0.0.5:8786"; None for processes on this machine.
    scheduler: str | None = None
    workers: int | None = None  # processes on this machine; None for one a core


@dataclass(frozen=True)
class SweepReport:
    """Counts and errors of a sweep."""

    finished_before: int  # results stored before
    finished_now: int  # worked out by this call
    # One line for each case without a result, such as a case that repeatedly ended its worker.
    failures: tuple[str, ...]
    wall_s: float  # time of this call [s]


def run_cases(
    cases: Sequence[Case],
    store: ResultStore,
    cluster: Cluster = Cluster(),
    progress: Progress = lambda _done, _total: None,
) -> SweepReport:
    """Run all cases without a stored result.

    A case whose work raises has a result: a row that says so in its column `error`. Every row also has the
    case's `seed`, in `seconds` the processor time that the case took, and whether it is the case's `first`.

    Args:
        cases: in order.
        store: where results are kept.
        cluster: where cases run.
        progress: called with the numbers of finished and of all cases.

    Raises:
        InputError: there is no such scheduler, it has no workers, they do not see the store's folder, or run
            other code.
        PalpateError: the scheduler was lost; the same call continues from there.
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
    """Run a case in a worker, and store its result.

    Args:
        case: the case.
        address: address of its result, by the client's code.
        folder: folder of the results.

    Raises:
        PalpateError: this worker's code is not the client's, as of one that joined later; or the case lacks
            something.
    """
    if case.address != address:
        raise PalpateError("a worker runs another version of palpate or of its libraries")
    case.check()
    begun_s = time.process_time()
    try:
        rows, error = case.run(), ""
    except Exception as problem:  # an error is a result as well: the same case would fail again
        rows, error = [{}], str(problem) if isinstance(problem, PalpateError) else describe_error(problem)
    common = {"seed": case.seed, "seconds": time.process_time() - begun_s, "error": error}
    landing = [row | common | {"first": number == 0} for number, row in enumerate(rows)]
    ResultStore(folder).land(address, landing)


def _run(cluster: Cluster, todo: dict[str, Case], store: ResultStore) -> Iterator[str]:
    """Yield an empty text for each finished case, else its error."""
    folder = store.folder.absolute()
    if not todo:
        return
    if cluster.scheduler is None:
        yield from run_in_processes(run_one, todo, folder, cluster.workers or os.cpu_count() or 1)
        return
    from distributed import Client  # noqa: PLC0415, takes half a second

    try:
        client = Client(cluster.scheduler, timeout=_JOIN_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"scheduler {cluster.scheduler}: does not answer ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_JOIN_S)
        except TimeoutError:
            raise InputError(f"scheduler {cluster.scheduler}: has no workers (dask worker ADDRESS)") from None
        # Refuse workers that do not write into this folder, or whose results would be of other code.
        modules = {case.work.partition(":")[0] for case in todo.values()}
        mark = store.folder.absolute() / f".seen-by-all-{uuid4().hex}"
        mark.touch()
        try:
            seen = client.run(_worker_code, mark, sorted(modules))
        finally:
            mark.unlink()
        ours = _worker_code(mark, sorted(modules))[1]
        for worker, (is_there, versions) in seen.items():
            if not is_there:
                raise InputError(
                    f"worker {worker}: cannot access {mark.parent}; --out must be on a shared disk"
                )
            if versions != ours:
                raise InputError(f"worker {worker}: runs another version of palpate or of its libraries")
        yield from _run_on_dask(client, todo, folder)


def _run_on_dask(client: Any, todo: dict[str, Case], folder: Path) -> Iterator[str]:  # noqa: ANN401, dask's
    """Do the same as `_run` on the workers of a dask scheduler."""
    from distributed import as_completed  # noqa: PLC0415, as above

    waiting = iter(todo.items())
    mark = uuid4().hex[:8]  # a key of an earlier client may still be running

    def submit(address: str, case: Case) -> Any:  # noqa: ANN401
        return client.submit(run_one, case, address, folder, key=f"case-{address}-{mark}", pure=False)

    pending = as_completed([submit(*arguments) for arguments in islice(waiting, _AHEAD)])
    for future in pending:
        problem = future.exception() if future.status == "error" else None
        if future.status in ("cancelled", "lost") or isinstance(problem, CancelledError):
            raise PalpateError(
                f"the scheduler {client.scheduler.addr if client.scheduler else ''} is gone; what is "
                "finished is kept, and the same command continues from there"
            )
        address = future.key.split("-")[1]
        yield f"{todo[address].label}: {problem}" if problem else ""
        for arguments in islice(waiting, 1):
            pending.add(submit(*arguments))


def _worker_code(mark: Path, modules: list[str]) -> tuple[bool, list[str]]:
    return mark.is_file(), [code_version(module) for module in modules]
