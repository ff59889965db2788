"""Benches on emulated wires, as the tests of the wire have them."""

from tests.wire.conftest import bench

__all__ = ["bench"]
