"""Functions that run in worker processes; this module imports little, so that workers start quickly."""

import signal


def send_blocked(pipe):
    pipe.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def do_nothing(pipe):
    pass
