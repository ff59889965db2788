"""Settings that all tests share."""

import os
import signal
import sys

from hypothesis import settings

# As in palpate itself: matrices are small here, and shared out over threads they cost several times as much.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Tests start hundreds of processes. Where a machine keeps no compiled modules, each would compile ours anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A busy machine is no failure; the same examples everywhere, so that a red test stays red until it is mended.
settings.register_profile("palpate", deadline=None, derandomize=True)
settings.load_profile("palpate")

# A shell starts jobs in the background with Ctrl-C switched off, nohup with SIGHUP, and both are inherited by
# every process below. The tests that press Ctrl-C must not depend on how they were started.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
