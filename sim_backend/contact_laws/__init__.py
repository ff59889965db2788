"""Contact laws, found by name; see `sim_backend.contact_law`."""

from sim_backend.contact_laws.standard import EngineContact, HuntCrossleyLaw, KelvinVoigtLaw

__all__ = ["EngineContact", "HuntCrossleyLaw", "KelvinVoigtLaw"]
