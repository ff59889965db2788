"""Settings that all tests share."""

import signal

from hypothesis import settings

# A busy machine is no failure; the same examples everywhere, so that a red test stays red until it is mended.
settings.register_profile("palpate", deadline=None, derandomize=True)
settings.load_profile("palpate")

# A shell starts jobs in the background with Ctrl-C switched off, nohup with SIGHUP, and both are inherited by
# every process below. The tests that press Ctrl-C must not depend on how they were started.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
