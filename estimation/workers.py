"""Worker processes, and settings of a process: threads of linear algebra and freed memory."""

import ctypes
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any


@contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of forked processes; any exception in the context, such as a signal, ends them at once.

    Args:
        processes: number of processes.
    """
    with ProcessPoolExecutor(processes, get_context("fork"), initializer=_prepare_worker) as pool:
        try:
            yield pool
        except BaseException:  # do not wait for the running computations
            for process in list((pool._processes or {}).values()):
                process.terminate()
            # Otherwise the pool waits for a partial result that only the terminated process could complete.
            pool._result_queue._writer.close()  # type: ignore[attr-defined]
            pool.shutdown(cancel_futures=True)
            raise


def _prepare_worker() -> None:
    """Prepare a worker: restore the default signal handlers and exit when the parent process exits."""
    end_with_parent()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def end_with_parent() -> None:
    """Exit this process when its parent exits, even if the parent is killed."""

    def wait_for_parent() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=wait_for_parent, daemon=True).start()


@cache
def _controller() -> Any:  # noqa: ANN401
    """Find the loaded BLAS libraries, only once because it takes long; None without threadpoolctl."""
    import scipy.linalg.lapack  # noqa: F401, PLC0415, has a BLAS of its own, which must be loaded to be found

    try:
        from threadpoolctl import ThreadpoolController  # noqa: PLC0415, optional
    except ImportError:
        return None
    return ThreadpoolController()


def single_threaded() -> AbstractContextManager[Any]:
    """Return a context that limits BLAS to one thread, which is faster for small matrices.

    Without threadpoolctl the context does nothing.
    """
    controller = _controller()
    limit: AbstractContextManager[Any] = nullcontext() if controller is None else controller.limit(limits=1)
    return limit


def release_freed_memory() -> None:
    """Return memory of deleted arrays to the system, which the GNU C library keeps between other arrays.

    After a recording of millions of samples these are hundreds of megabytes. Other C libraries do nothing.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
