"""Start a worker process and communicate with it over a pipe."""

import signal
from collections.abc import Callable
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import current_thread, main_thread
from typing import Any


def start_worker(
    target: Callable[..., None], *arguments: object
) -> tuple[BaseProcess, "Connection[Any, Any]"]:
    """Start a process with a new interpreter; it ends when this process ends regularly.

    Ctrl-C reaches all processes of a terminal; only this process handles it.

    Args:
        target: function of a module, called in the new process as `target(pipe, *arguments)`.
        arguments: objects that can be pickled.

    Returns:
        The process, and this side's end of its pipe, which reads end-of-file once the process has ended.
    """
    context = get_context("spawn")
    pipe, worker_end = context.Pipe()
    process = context.Process(target=target, args=(worker_end, *arguments), daemon=True)
    # Ctrl-C is blocked in the new process, and deferred in this one.
    resource_tracker.ensure_running()  # its start would unblock the signal
    deferred = list[int]()
    handler = signal.getsignal(signal.SIGINT)
    if current_thread() is main_thread():  # another thread may receive the signal; the main thread handles it
        signal.signal(signal.SIGINT, lambda number, _: deferred.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # new processes inherit it
    try:
        process.start()
    finally:
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number in deferred:
            signal.raise_signal(number)
    worker_end.close()
    return process, pipe
