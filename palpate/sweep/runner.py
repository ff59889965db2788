"""Run the unfinished cases of a sweep in local processes or on dask workers.

Local processes communicate over pipes, which no other program can open; no port is opened.
"""

import os
import sys
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
from types import ModuleType
from typing import Any
from uuid import uuid4

from threadpoolctl import threadpool_limits

from palpate.common.worker_process import start_worker
from palpate.estimation.workers import end_with_parent
from palpate.robot_io.errors import InputError, PalpateError, describe_error
from palpate.sweep.case import Case, ResultStore, code_version

_MOST_ENDS = 4  # number of workers that a case may crash before it is given up
_END_LIMIT_S = 5.0  # time limit for a worker's end


def run_in_processes(todo: Mapping[str, Case], folder: Path, workers: int) -> Iterator[str]:
    """Run all cases; if a worker dies, replace it and restart its case.

    Args:
        todo: cases by address.
        folder: folder of the results.
        workers: number of worker processes.

    Yields:
        An empty string for each finished case, or the reason why it failed.
    """
    waiting, ends = deque(todo), Counter[str]()
    pool: dict[Connection[Any, Any], BaseProcess] = {}  # by this side's end of the pipe
    busy: dict[Connection[Any, Any], str] = {}  # address of the running case

    def start() -> "Connection[Any, Any]":
        """Start a worker without the main script, which need not guard its calls by `__name__`."""
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            process, pipe = start_worker(_serve, folder)
        finally:
            sys.modules["__main__"] = main
        pool[pipe] = process
        return pipe

    try:
        idle = [start() for _ in range(min(workers, len(todo)))]
        while waiting or busy:
            while waiting and idle:
                pipe, address = idle.pop(), waiting.popleft()
                busy[pipe] = address
                with suppress(OSError):  # a dead worker is detected when its answer is read
                    pipe.send((todo[address], address))
            ready = wait(list(busy))
            for pipe in [pipe for pipe in busy if pipe in ready]:
                address = busy.pop(pipe)
                try:
                    problem = pipe.recv()
                    idle.append(pipe)
                except (EOFError, OSError):  # the worker was killed, or the memory was full
                    del pool[pipe]
                    idle.append(start())
                    ends[address] += 1
                    problem = f"its worker process died {ends[address]} times"
                    if ends[address] < _MOST_ENDS:
                        waiting.append(address)
                        problem = None
                if problem is not None:
                    yield f"{todo[address].label}: {problem}" if problem else ""
    finally:
        for process in pool.values():
            process.terminate()
        for process in pool.values():
            process.join(_END_LIMIT_S)


def _serve(pipe: "Connection[str, tuple[Case, str]]", folder: Path) -> None:
    """Run cases as they arrive, and send an empty string or the error for each."""
    end_with_parent()
    # Each core has its own worker. The parent may end, or end the pipe.
    with threadpool_limits(1), suppress(EOFError, ConnectionError):
        while True:
            case, address = pipe.recv()
            try:
                run_one(case, address, folder)
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
    workers: int | None = None  # number of local processes; None for one per core


@dataclass(frozen=True)
class SweepReport:
    """Counts and errors of a sweep."""

    finished_before: int  # results stored before
    finished_now: int  # results computed by this call
    # One line for each case without a result, such as a case that repeatedly crashed its worker.
    failures: tuple[str, ...]
    wall_s: float  # time of this call [s]


def run_cases(
    cases: Sequence[Case],
    store: ResultStore,
    cluster: Cluster = Cluster(),
    progress: Progress = lambda _done, _total: None,
) -> SweepReport:
    """Run all cases without a stored result.

    A case whose work raises has one row with the message in column `error`. Each row also has the case's
    `seed`, its processor time in `seconds`, and in `first` whether it is the case's first row.

    Args:
        cases: cases in order.
        store: store of the results.
        cluster: processes or machines that run the cases.
        progress: called with the numbers of finished and of all cases.

    Raises:
        InputError: the scheduler does not exist or has no workers, or the workers cannot access the store's
            folder or run different code.
        PalpateError: the connection to the scheduler was lost; a repeated call continues.
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
        address: address of the case's result, computed from the client's code.
        folder: folder of the results.

    Raises:
        PalpateError: this worker's code differs from the client's (for example, the worker joined later), or
            the case lacks an input.
    """
    if case.address != address:
        raise PalpateError("a worker runs a different version of palpate or of its libraries")
    case.check()
    begun_s = time.process_time()
    try:
        rows, error = case.run(), ""
    except Exception as problem:  # an error is a result too, because the same case would fail again
        rows, error = [{}], str(problem) if isinstance(problem, PalpateError) else describe_error(problem)
    common = {"seed": case.seed, "seconds": time.process_time() - begun_s, "error": error}
    landing = [row | common | {"first": number == 0} for number, row in enumerate(rows)]
    ResultStore(folder).write(address, landing)


def _run(cluster: Cluster, todo: dict[str, Case], store: ResultStore) -> Iterator[str]:
    """Yield an empty string for each finished case, or else its error."""
    folder = store.folder.absolute()
    if not todo:
        return
    if cluster.scheduler is None:
        yield from run_in_processes(todo, folder, cluster.workers or os.cpu_count() or 1)
        return
    from distributed import Client, as_completed  # noqa: PLC0415, takes half a second

    try:
        client = Client(cluster.scheduler, timeout=_JOIN_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"scheduler {cluster.scheduler}: does not answer ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_JOIN_S)
        except TimeoutError:
            raise InputError(
                f"scheduler {cluster.scheduler}: has no workers; start one with: dask worker ADDRESS"
            ) from None
        # Reject workers that cannot write to this folder or that run different code.
        modules = {case.task.partition(":")[0] for case in todo.values()}
        mark = store.folder.absolute() / f".seen-by-all-{uuid4().hex}"
        mark.touch()
        try:
            seen = client.run(_worker_code, mark, sorted(modules))
        finally:
            mark.unlink()
        ours = _worker_code(mark, sorted(modules))[1]
        for worker, (is_there, versions) in seen.items():
            if not is_there:
                raise InputError(f"worker {worker}: cannot access {mark.parent}; use a shared disk for --out")
            if versions != ours:
                raise InputError(f"worker {worker}: runs a different version of palpate or of its libraries")
        waiting = iter(todo.items())
        stamp = uuid4().hex[:8]  # a task of an earlier client may still be running under its key

        def submit(address: str, case: Case) -> Any:  # noqa: ANN401
            key = f"case-{address}-{stamp}"
            return client.submit(run_one, case, address, folder, key=key, pure=False)

        pending = as_completed([submit(*arguments) for arguments in islice(waiting, _AHEAD)])
        for future in pending:
            problem = future.exception() if future.status == "error" else None
            if future.status in ("cancelled", "lost") or isinstance(problem, CancelledError):
                raise PalpateError(
                    f"the scheduler {client.scheduler.addr if client.scheduler else ''} was lost; "
                    "finished cases are saved; run the same command again to continue"
                )
            address = future.key.split("-")[1]
            yield f"{todo[address].label}: {problem}" if problem else ""
            for arguments in islice(waiting, 1):
                pending.add(submit(*arguments))


def _worker_code(mark: Path, modules: list[str]) -> tuple[bool, list[str]]:
    return mark.is_file(), [code_version(module) for module in modules]
