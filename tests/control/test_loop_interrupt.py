"""Signals become a flag while it is wanted, and the former handlers come back."""

import os
import signal
import threading

import pytest

from control.loop.way_out import InterruptFlag


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_sets_the_flag_and_raises_nothing(number):
    with InterruptFlag() as flag:
        assert flag.signal_name is None
        os.kill(os.getpid(), number)
        assert flag.signal_name == number.name


def test_the_first_signal_is_kept():
    with InterruptFlag() as flag:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        assert flag.signal_name == "SIGTERM"


def test_former_handlers_come_back_and_ctrl_c_works_again():
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with InterruptFlag():
        pass
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_a_signal_that_was_switched_off_stays_off():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    try:
        with InterruptFlag() as flag:
            os.kill(os.getpid(), signal.SIGHUP)
            assert flag.signal_name is None
    finally:
        signal.signal(signal.SIGHUP, before)


def test_outside_the_main_thread_handlers_are_left_alone():
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def run():
        with InterruptFlag() as flag:
            seen.append((signal.getsignal(signal.SIGINT), flag.signal_name))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [(before, None)]
