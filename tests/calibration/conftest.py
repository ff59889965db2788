"""The probing session of the face's tests, and how it is written."""

from tests.palpate.conftest import log_in_process, probed

__all__ = ["log_in_process", "probed"]
