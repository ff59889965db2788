"""Emulated devices for the drivers, written from the protocols' manuals."""

from palpate.sim_backend.emulators.faults import Fault, FaultKind, Faults

__all__ = ["Fault", "FaultKind", "Faults"]
