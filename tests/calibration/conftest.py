"""Sessions without a process for each."""

from tests.palpate.conftest import log_in_process

__all__ = ["log_in_process"]
