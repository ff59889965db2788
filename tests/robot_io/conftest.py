"""Benches on emulated wires, as the tests of the wire have them."""

from tests.wire.conftest import bench, few_ids

__all__ = ["bench", "few_ids"]
