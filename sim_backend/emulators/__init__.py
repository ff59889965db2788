"""Emulated devices for the drivers, written from the protocols' manuals.

All times (`now_s`) are those of the bench's clock [s].
"""

from palpate.sim_backend.emulators.faults import Fault, FaultKind, Faults

__all__ = ["Fault", "FaultKind", "Faults"]
