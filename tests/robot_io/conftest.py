"""Robots on emulated wires, as the tests of the wire have them."""

from tests.wire.conftest import few_ids, make_robot

__all__ = ["few_ids", "make_robot"]
