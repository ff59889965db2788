"""Settings that all tests share."""

import gc
import os
import signal
import sys
from functools import lru_cache

from hypothesis import settings

# As in palpate itself: matrices are small here, and shared out over threads they cost several times as much.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Processes keep freed memory for their next arrays; giving it back costs a twentieth of the processor time.
os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", str(1 << 28))
os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", str(1 << 25))

# What is printed is as wide as a pipe has it, and not as the terminal that the tests were started in.
os.environ.pop("COLUMNS", None)

# Tests start hundreds of processes. Where a machine keeps no compiled modules, each would compile ours anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Half a million objects of imported modules are looked through at each full collection.
gc.set_threshold(20_000, 20, 20)

# A busy machine is no failure; the same examples everywhere, so that a red test stays red until it is mended.
settings.register_profile("soon", deadline=None, derandomize=True, max_examples=20)
settings.register_profile("all", settings.get_profile("soon"), max_examples=100)
settings.load_profile("soon")


def pytest_configure(config):
    """Read the same few files once; `make test-all`, which leaves no slow test out, tries more examples."""
    from palpate.robot_io.files import file_model  # once the number of threads is set

    file_model._parse_nodes = lru_cache(maxsize=64)(file_model._parse_nodes)
    if not config.option.markexpr:
        settings.load_profile("all")


# A shell starts jobs in the background with Ctrl-C switched off, nohup with SIGHUP, and both are inherited by
# every process below. The tests that press Ctrl-C must not depend on how they were started.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
