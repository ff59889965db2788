"""Start a worker process and communicate with it over a pipe."""

from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any


def start_worker(
    target: Callable[..., None], *arguments: object
) -> tuple[BaseProcess, "Connection[Any, Any]"]:
    """Start a process with a new interpreter; it ends when this process ends regularly.

    Args:
        target: function of a module, called in the new process as `target(pipe, *arguments)`.
        arguments: objects that can be pickled.

    Returns:
        The process, and this side's end of its pipe, which reads end-of-file once the process has ended.
    """
    context = get_context("spawn")
    pipe, worker_end = context.Pipe()
    process = context.Process(target=target, args=(worker_end, *arguments), daemon=True)
    process.start()
    worker_end.close()
    return process, pipe
