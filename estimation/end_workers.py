"""Ends the processes of a pool, whatever they are doing."""

import signal
from concurrent.futures import ProcessPoolExecutor


def end_workers(pool: ProcessPoolExecutor) -> None:
    """End a pool and its processes at once; what they were computing is lost."""
    for process in list((pool._processes or {}).values()):
        process.terminate()
    # else half a result would be waited for: only the process that ended could complete it
    pool._result_queue._writer.close()  # type: ignore[attr-defined]
    pool.shutdown(cancel_futures=True)


def end_when_told() -> None:
    """Begin a worker: handlers of the process that forked are not its own, and a signal ends it at once."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
