"""The probing session that the calibration tests share."""

from tests.palpate.conftest import log_in_process, probed

__all__ = ["log_in_process", "probed"]
