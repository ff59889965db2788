"""Works cases out in processes of this machine, over pipes that nobody else can open: no port listens."""

import signal
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from threadpoolctl import threadpool_limits

from estimation.end_workers import end_with_parent
from palpate.sweep.case import Case
from robot_io.errors import PalpateError, describe_error

_MOST_ENDS = 4  # of workers by one case, before it is given up
_JOIN_S = 5.0  # for a worker to end that was told to

Run = Callable[[Case, str, Path], None]  # works out a case, by its address, for the store in a folder


def run_in_processes(run: Run, todo: Mapping[str, Case], folder: Path, workers: int) -> Iterator[str]:
    """Work out all cases, by address; a worker that ends is replaced, and its case begins again.

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
                    yield f"case {dict(todo[address].parameters)}: {problem}" if problem else ""
    finally:
        for worker in pool:
            worker.process.terminate()
        for worker in pool:
            worker.process.join(_JOIN_S)


@dataclass(frozen=True)
class _Worker:
    """A process, and the pipe to it."""

    process: BaseProcess
    pipe: "Connection[tuple[Case, str], str]"

    @classmethod
    def start(cls, run: Run, folder: Path) -> "_Worker":
        """A new process, which waits for its first case."""
        context = get_context("spawn")
        own, other = context.Pipe()
        process = context.Process(target=_serve, args=(other, run, folder), daemon=True)
        process.start()
        other.close()
        return cls(process, own)

    def give(self, case: Case, address: str) -> None:
        """Let it work out a case; that it has ended is seen when the answer is asked for."""
        with suppress(OSError):
            self.pipe.send((case, address))


def _serve(pipe: "Connection[str, tuple[Case, str]]", run: Run, folder: Path) -> None:
    """What a worker does: work out what comes, and say each time why it could not."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever began it
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
