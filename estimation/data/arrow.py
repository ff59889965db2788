"""Lazy import of pyarrow, which takes long to load."""

from typing import TYPE_CHECKING

from palpate.robot_io.extras import LazyModule

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.csv as pa_csv
else:
    pa, pc, pa_csv = map(LazyModule, ("pyarrow", "pyarrow.compute", "pyarrow.csv"))

__all__ = ["pa", "pa_csv", "pc"]
