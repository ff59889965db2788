"""Worker processes that a signal ends at once, and linear algebra in a single thread."""

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from multiprocessing import parent_process
from threading import Thread
from typing import Any


def end_workers(pool: ProcessPoolExecutor) -> None:
    """End a pool and its processes at once; running computations are lost.

    Args:
        pool: the pool; it takes no further work.
    """
    for process in list((pool._processes or {}).values()):
        process.terminate()
    # else half a result would be waited for: only the process that ended could complete it
    pool._result_queue._writer.close()  # type: ignore[attr-defined]
    pool.shutdown(cancel_futures=True)


def end_when_told() -> None:
    """Prepare a worker: restore default signal handlers, and end with the parent process."""
    end_with_parent()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def end_with_parent() -> None:
    """Let this process end with its parent, also if the parent is killed and cannot end it."""

    def wait_for_parent() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=wait_for_parent, daemon=True).start()


@cache
def _controller() -> Any:  # noqa: ANN401
    """Find the loaded BLAS libraries, once: that takes longer than some fits. None without threadpoolctl."""
    try:
        from threadpoolctl import ThreadpoolController  # noqa: PLC0415, optional
    except ImportError:
        return None
    return ThreadpoolController()


def single_threaded() -> AbstractContextManager[Any]:
    """Limit BLAS to one thread within the context, which is faster for small matrices.

    Without threadpoolctl nothing changes.
    """
    controller = _controller()
    limit: AbstractContextManager[Any] = nullcontext() if controller is None else controller.limit(limits=1)
    return limit
