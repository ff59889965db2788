"""Real-time help is put back as it was, and refusals are words, not errors."""

import ctypes
import gc
import os
import sys
from pathlib import Path

import pytest

from control.loop import realtime as module
from control.loop.realtime import realtime

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the switches are Linux's")


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


def test_everything_is_put_back(policy):
    before = switches()
    assert before[0] == policy
    with realtime() as report:
        during = switches()
    assert switches() == before
    assert report.granted  # frozen garbage and fine timer need no rights
    assert during != before


def test_what_is_granted_is_on():
    with realtime(priority=7) as report:
        policy, priority, locked, frozen, slack_ns = switches()
    assert (policy == os.SCHED_FIFO and priority == 7) == ("SCHED_FIFO" in report.granted)
    assert (int(locked.split()[1]) > 0) == ("memory lock" in report.granted)
    assert (frozen > 0) == ("frozen garbage" in report.granted)
    assert (slack_ns <= 1) == ("fine timer" in report.granted)  # 0: a FIFO thread has none


def test_everything_is_put_back_after_an_exception():
    before = switches()
    with pytest.raises(ZeroDivisionError), realtime():
        raise ZeroDivisionError
    assert switches() == before


def test_a_refusal_is_said_in_words_with_what_to_do(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with realtime() as report:
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert not report.complete
    line = next(line for line in report.refused if "SCHED_FIFO" in line)
    assert "Operation not permitted" in line
    assert "rtprio" in line
    assert line in str(report)
    assert "frozen garbage" in report.granted  # one refusal does not cost the others


def test_threads_and_processes_started_inside_are_scheduled_normally():
    with realtime():
        child = os.fork()
        if child == 0:
            os._exit(os.sched_getscheduler(0))
        _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == os.SCHED_OTHER


def test_memory_to_come_is_not_locked_under_a_limit(monkeypatch):
    import resource

    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 << 20, 8 << 20))
    assert not module._may_lock_any_amount()
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert module._may_lock_any_amount()


def test_on_another_system_it_says_so(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    with realtime() as report:
        pass
    assert any("darwin" in line for line in report.refused)
