"""Emulated devices at the other end of the drivers' wires, written from the protocols' manuals."""

from palpate.sim_backend.emulators.faults import Fault, FaultKind, Faults

__all__ = ["Fault", "FaultKind", "Faults"]
