"""The probing session of the face's tests."""

from tests.palpate.conftest import probed

__all__ = ["probed"]
