"""Worker processes leave Ctrl-C to the process that started them, from their first moment on."""

import signal
from multiprocessing.context import SpawnProcess

import pytest

from palpate.common.worker_process import start_worker


def send_blocked(pipe):
    pipe.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def do_nothing(pipe):
    pass


def test_ctrl_c_is_blocked_in_a_worker_and_not_here():
    process, pipe = start_worker(send_blocked)
    assert pipe.recv()
    process.join()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_ctrl_c_while_a_worker_starts_is_handled_afterwards(monkeypatch):
    start, started = SpawnProcess.start, []

    def interrupted(process):
        signal.raise_signal(signal.SIGINT)
        start(process)
        started.append(process)

    monkeypatch.setattr(SpawnProcess, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        start_worker(do_nothing)
    started[0].join()
    assert started[0].exitcode == 0
