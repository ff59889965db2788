"""An ATI Net F/T on a network socket."""

from sim_backend.emulators.net_ft.box import EmulatedNetFt, NetFtLine, record

__all__ = ["EmulatedNetFt", "NetFtLine", "record"]
