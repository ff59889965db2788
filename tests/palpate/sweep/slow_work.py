"""A case that takes a while, and leaves a line in a file when it starts; for tests that kill."""

import os
import signal
import time
from pathlib import Path


def work(parameters, seed):
    with Path(parameters["starts"]).open("a") as file:
        file.write(f"{seed} {os.getpid()}\n")
    time.sleep(parameters["seconds"])
    return [{"square": seed**2, "half": part} for part in (0, 1)]


def failing(parameters, seed):
    raise ValueError(f"no {parameters['what']}")


def fatal(parameters, seed):
    if seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return [{"square": seed**2}]
