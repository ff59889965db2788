"""Contact laws, one file each, found by name; see `sim_backend.contact_law`."""

from sim_backend.contact_laws.engine import EngineContact
from sim_backend.contact_laws.hunt_crossley import HuntCrossley
from sim_backend.contact_laws.kelvin_voigt import KelvinVoigt

__all__ = ["EngineContact", "HuntCrossley", "KelvinVoigt"]
