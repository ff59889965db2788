"""Rerun's modules, each imported on first use, because only an extra installs them."""

from typing import TYPE_CHECKING

from palpate.robot_io.extras import LazyModule

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb
    import rerun.urdf as urdf_reader
    import rerun_cli  # type: ignore[import-untyped]
    from rerun import experimental
else:
    rr = LazyModule("rerun")
    rrb = LazyModule("rerun.blueprint")
    urdf_reader = LazyModule("rerun.urdf")
    rerun_cli = LazyModule("rerun_cli")
    experimental = LazyModule("rerun.experimental")

__all__ = ["experimental", "rerun_cli", "rr", "rrb", "urdf_reader"]
