"""Real-time settings: restored afterwards, and refusals reported without an error."""

import ctypes
import gc
import os
import sys
import weakref
from pathlib import Path
from types import SimpleNamespace

import pytest

from palpate.control.loop import realtime as module
from palpate.control.loop.realtime import realtime

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the switches are Linux's")


@pytest.fixture(autouse=True)
def nothing_collected(monkeypatch):
    """To look through all objects of a process of the tests takes half a second."""
    monkeypatch.setattr(gc, "collect", lambda: 0)


def switches():
    status = Path("/proc/self/status").read_text(encoding="ascii")
    locked = next(line for line in status.splitlines() if line.startswith("VmLck"))
    slack_ns = ctypes.CDLL(None).prctl(30, 0, 0, 0, 0)
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return policy, os.sched_getparam(0).sched_priority, locked, gc.get_freeze_count(), slack_ns


@pytest.fixture(params=[os.SCHED_OTHER, os.SCHED_BATCH] if sys.platform == "linux" else [])
def policy(request):
    """The policy of whoever asks for help, which need not be the system's usual one."""
    os.sched_setscheduler(0, request.param, os.sched_param(0))
    yield request.param
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def test_settings_are_restored(policy):
    before = switches()
    assert before[0] == policy
    with realtime() as report:
        during = switches()
    assert switches() == before
    assert report.granted  # frozen garbage and fine timer need no rights
    assert during != before


def test_realtime_settings_are_restored_after_an_exception():
    with realtime() as report:
        policy, priority, locked, frozen, slack_ns = switches()
    assert (policy == os.SCHED_FIFO and priority == 80) == ("SCHED_FIFO" in report.granted)
    assert (int(locked.split()[1]) > 0) == ("memory lock" in report.granted)
    assert (frozen > 0) == ("frozen garbage" in report.granted)
    assert (slack_ns <= 1) == ("fine timer" in report.granted)  # 0: a FIFO thread has none
    before = switches()
    with pytest.raises(ZeroDivisionError), realtime():
        raise ZeroDivisionError
    assert switches() == before


def test_refusal_states_its_reason_and_a_remedy(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with realtime() as report:
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert not report.complete
    line = next(line for line in report.refused if "SCHED_FIFO" in line)
    assert "Operation not permitted" in line
    assert "rtprio" in line
    assert str(report).startswith("real-time help: ")
    assert f"; {line}" in str(report)
    assert "frozen garbage" in report.granted  # one refusal does not cost the others


def test_threads_and_processes_started_inside_are_scheduled_normally():
    with realtime():
        child = os.fork()
        if child == 0:
            os._exit(os.sched_getscheduler(0))
        _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == os.SCHED_OTHER


@pytest.mark.parametrize(("user", "limit", "may"), [(0, 8 << 20, True), (1, 8 << 20, False), (1, -1, True)])
def test_future_memory_is_not_locked_under_a_limit(monkeypatch, user, limit, may):
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(module.resource, "getrlimit", lambda _: (limit, module.resource.RLIM_INFINITY))
    assert module._may_lock_any_amount() is may


def test_other_operating_system_is_reported(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    with realtime() as report:
        pass
    refused = [line.split(" (")[0] for line in report.refused if "not available on darwin" in line]
    assert refused == ["no fine timer", "no SCHED_FIFO", "no memory lock"]
    assert set(report.granted) <= {"awake processor", "frozen garbage"}


def test_sleep_ends_on_time_and_as_before_afterwards():
    """Asked by itself: a thread with real-time scheduling has no slack anyway."""
    libc = ctypes.CDLL(None)
    before_ns = libc.prctl(30)
    libc.prctl(29, 12_345)
    with module._fine_timer():
        assert libc.prctl(30) == 1
    assert libc.prctl(30) == 12_345
    libc.prctl(29, before_ns)


class Scheduler:
    """What the system was asked for; it may refuse to take the reset-on-fork flag off."""

    def __init__(self, monkeypatch, *, refuses):
        self.asked, self._refuses = [], refuses
        monkeypatch.setattr(os, "sched_setscheduler", self.set)

    def set(self, pid, policy, param):
        self.asked.append((pid, policy, param.sched_priority))
        if self._refuses and not policy & os.SCHED_RESET_ON_FORK:
            raise PermissionError


@pytest.mark.parametrize("refuses", [False, True])
def test_scheduling_is_restored_as_far_as_the_system_allows(monkeypatch, refuses):
    scheduler = Scheduler(monkeypatch, refuses=refuses)
    with realtime():
        pass
    raised, *back = scheduler.asked
    assert raised == (0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 80)
    usual = (0, os.SCHED_OTHER, 0)
    assert back == [usual, *([(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)] if refuses else [])]


@pytest.mark.parametrize(("any_amount", "flags"), [(True, 7), (False, 5)])
@pytest.mark.parametrize("locked_kib", [0, 64])
def test_current_and_future_memory_is_locked_once(monkeypatch, any_amount, flags, locked_kib):
    calls = []

    def libc(name, *, use_errno):
        assert use_errno
        return SimpleNamespace(
            mlockall=lambda wanted: calls.append(wanted) or 0, munlockall=lambda: calls.append("unlocked")
        )

    monkeypatch.setattr(ctypes, "CDLL", libc)
    monkeypatch.setattr(module, "_may_lock_any_amount", lambda: any_amount)
    monkeypatch.setattr(module, "_locked_kib", lambda: locked_kib)
    with module._locked_memory():
        assert calls == ([] if locked_kib else [flags])
    assert calls == ([] if locked_kib else [flags, "unlocked"])


@pytest.mark.parametrize(
    ("switch", "refused"), [("_locked_memory", ()), ("_fine_timer", (29,)), ("_fine_timer", (30,))]
)
def test_operating_system_refusal_is_reported_with_its_reason(monkeypatch, switch, refused):
    libc = SimpleNamespace(mlockall=lambda _: -1, prctl=lambda option, *_: -1 if option in refused else 0)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, use_errno: libc if use_errno else None)
    monkeypatch.setattr(ctypes, "get_errno", lambda: 12)
    monkeypatch.setattr(module, "_locked_kib", lambda: 0)
    with pytest.raises(OSError, match="Cannot allocate memory"), getattr(module, switch)():
        pass


def test_latency_request_lasts_while_the_file_is_open(monkeypatch, tmp_path):
    opened = []

    def to_a_file(path, mode, **how):
        assert path == "/dev/cpu_dma_latency"
        opened.append(open(tmp_path / "latency", mode, **how))  # noqa: SIM115, as what it stands for
        return opened[0]

    monkeypatch.setattr(module, "open", to_a_file, raising=False)
    with module._awake_processor():
        assert (tmp_path / "latency").read_bytes() == bytes(4)
        assert not opened[0].closed
    assert opened[0].closed


def test_garbage_is_collected_before_it_is_frozen(monkeypatch):
    monkeypatch.undo()

    class Node:
        pass

    node = Node()
    node.itself, seen = node, weakref.ref(node)
    del node
    with realtime():
        assert seen() is None
