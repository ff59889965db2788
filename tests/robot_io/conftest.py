"""Robots on emulated wires, as in tests/wire."""

from tests.wire.conftest import few_ids, make_robot

__all__ = ["few_ids", "make_robot"]
