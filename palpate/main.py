"""Entry point of the `palpate` command: check the prerequisites, then load the commands."""

import atexit
import gc
import io
import os
import signal
import sys
import warnings
from contextlib import suppress

from palpate.common import preflight

INTERRUPTED = 130


def main() -> None:
    """Run the process; it exits with 0 (done), 1 (failed), 2 (bad input), 3 (disk full) or 130 (Ctrl-C)."""
    for number in (signal.SIGTERM, signal.SIGHUP):  # raise an exception, so that unfinished files are removed
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, lambda ended_by, _: sys.exit(128 + ended_by))
    # Searching for reference cycles takes an eighth of a short command and finds hardly any. Search less
    # often, and not at the end of the process.
    gc.set_threshold(10_000)
    atexit.register(gc.freeze)
    # A child process of multiprocessing or dask would import from the current folder before the library.
    os.environ["PYTHONSAFEPATH"] = "1"
    # Matrices are small here; threads would take up to twenty times the processor time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not sys.warnoptions:
        warnings.simplefilter("ignore", RuntimeWarning)
    sys.stdout, sys.stderr = sys.stdout or _null_stream(), sys.stderr or _null_stream()
    for stream in (sys.stdout, sys.stderr):  # characters that a terminal cannot show are written as \u2013
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        run()
    except SystemExit as end:
        if isinstance(end.code, int) and end.code:
            # The interpreter's cleanup would abort in library threads that have just started.
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError):
                    stream.flush()
            os._exit(end.code)
        raise
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the interpreter's cleanup remains


def run() -> None:
    """Run the command line; raise `SystemExit` with the exit code."""
    try:
        if problem := preflight.first_problem():
            sys.exit(_refuse(problem))
        try:
            from palpate.commands import app  # noqa: PLC0415, only after the prerequisites are checked
        except ModuleNotFoundError as error:
            from palpate.robot_io.extras import install_command  # noqa: PLC0415, as above

            missing = f"the Python package '{error.name or error}' is not installed"
            sys.exit(_refuse(f"{missing}: {install_command()}"))
        app()
    except KeyboardInterrupt:  # while commands are imported; afterwards the commands handle it
        print("palpate: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _null_stream() -> io.TextIOWrapper:
    """Return a stream to the null device, for a stream that was closed before the start."""
    return io.TextIOWrapper(io.FileIO(os.devnull, "w"))


def _refuse(problem: str) -> int:
    print(f"palpate: {problem}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
