"""Functions for worker processes, which import nothing else with them."""

import signal


def send_blocked(pipe):
    pipe.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def do_nothing(pipe):
    pass
