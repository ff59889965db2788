"""Run linear algebra in a single thread: for small matrices, several threads take longer than one."""

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any


@cache
def _controller() -> Any:  # noqa: ANN401
    """Find the loaded BLAS libraries, once: that takes longer than some fits. None without threadpoolctl."""
    try:
        from threadpoolctl import ThreadpoolController  # noqa: PLC0415, optional
    except ImportError:
        return None
    return ThreadpoolController()


def single_threaded() -> AbstractContextManager[Any]:
    """Limit BLAS to one thread within the context; without threadpoolctl, change nothing."""
    controller = _controller()
    limit: AbstractContextManager[Any] = nullcontext() if controller is None else controller.limit(limits=1)
    return limit
