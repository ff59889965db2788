"""Real-time features of the operating system: enabled where permitted, otherwise reported."""

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # Linux, sys/mman.h
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30  # Linux, prctl(2)
_PRIORITY = 80  # of 1 to 99, above the usual 50 of interrupt threads
_TIMER_SLACK_NS = 1  # the default of 50 us is added to every sleep of a thread without real-time scheduling


@dataclass(frozen=True, slots=True)
class RealtimeReport:
    """Granted and refused real-time features."""

    granted: tuple[str, ...]  # names of granted features, such as "SCHED_FIFO"
    refused: tuple[str, ...]  # one line per refused feature: name, reason and remedy

    @property
    def complete(self) -> bool:
        """Whether everything was granted."""
        return not self.refused

    def __str__(self) -> str:
        granted = ", ".join(self.granted) or "none"
        return f"real-time help: {granted}" + "".join(f"; {line}" for line in self.refused)


@contextmanager
def realtime() -> Iterator[RealtimeReport]:
    """Enable real-time features for the calling thread within the context; restore everything afterwards.

    Use it only for loops on a real clock: on simulated time the thread never sleeps and would starve others.
    A refused feature is not an error.

    Yields:
        Report of granted and refused features.
    """
    switches: tuple[tuple[str, str, Callable[[], AbstractContextManager[None]]], ...] = (
        ("fine timer", "each sleep may be 50 us longer", _fine_timer),
        (
            "SCHED_FIFO",
            "other programs may delay a tick by milliseconds; to allow SCHED_FIFO, write 'rtprio 99' in "
            "/etc/security/limits.conf",
            _fifo,
        ),
        (
            "memory lock",
            "memory that was swapped out may delay a tick; to allow locking, write 'memlock unlimited' in "
            "/etc/security/limits.conf",
            _locked_memory,
        ),
        ("awake processor", "it may enter a deep sleep and need 100 us to wake", _awake_processor),
        ("frozen garbage", "a garbage collection may delay a tick", lambda: frozen_garbage(collect=True)),
    )
    granted, refused = [], []
    with ExitStack() as stack:
        for name, consequence, switch in switches:
            try:
                stack.enter_context(switch())
                granted.append(name)
            except OSError as error:
                refused.append(f"no {name} ({error.strerror}): {consequence}")
        yield RealtimeReport(tuple(granted), tuple(refused))


@contextmanager
def _fifo() -> Iterator[None]:
    """Set SCHED_FIFO for this thread only; threads and processes that it starts are scheduled normally."""
    _require_linux()
    former, former_param = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
    try:
        yield
    finally:
        try:
            os.sched_setscheduler(0, former, former_param)
        except PermissionError:  # only a privileged thread may clear the reset-on-fork flag
            os.sched_setscheduler(0, former | os.SCHED_RESET_ON_FORK, former_param)


@contextmanager
def _locked_memory() -> Iterator[None]:
    """Lock pages once they are used, since Arrow reserves a gigabyte that it never uses.

    Future pages are locked only if no limit could make an allocation fail.
    """
    _require_linux()
    if _locked_kib():  # an existing lock is kept
        yield
        return
    libc = ctypes.CDLL(None, use_errno=True)
    flags = _MCL_ONFAULT | _MCL_CURRENT | (_MCL_FUTURE if _may_lock_any_amount() else 0)
    _check(libc.mlockall(flags))
    try:
        yield
    finally:
        libc.munlockall()


@contextmanager
def _fine_timer() -> Iterator[None]:
    _require_linux()
    libc = ctypes.CDLL(None, use_errno=True)
    former_ns = libc.prctl(_PR_GET_TIMERSLACK)
    _check(former_ns)
    _check(libc.prctl(_PR_SET_TIMERSLACK, _TIMER_SLACK_NS))
    try:
        yield
    finally:
        libc.prctl(_PR_SET_TIMERSLACK, former_ns)


@contextmanager
def _awake_processor() -> Iterator[None]:
    """Request zero wake-up latency from Linux; the request is valid while the file is open."""
    with open("/dev/cpu_dma_latency", "wb", buffering=0) as request:
        request.write((0).to_bytes(4, sys.byteorder))
        yield


@contextmanager
def frozen_garbage(*, collect: bool) -> Iterator[None]:
    """Exclude all existing objects from garbage collections in the context, to keep these short.

    Args:
        collect: whether to collect garbage before, which takes up to 0.1 s.
    """
    if gc.get_freeze_count():  # an existing freeze is kept
        yield
        return
    if collect:
        gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _require_linux() -> None:
    if sys.platform != "linux":
        raise OSError(0, f"not available on {sys.platform}")


def _check(result: int) -> None:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _locked_kib() -> int:
    with open("/proc/self/status", encoding="ascii") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmLck:"))


def _may_lock_any_amount() -> bool:
    return os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
