"""Spring and damper in parallel: the paper's contact model."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.contact_offset import ContactOffset
from estimation.effects.damping import Damping
from estimation.effects.stiffness import Stiffness
from estimation.model import Model


class KelvinVoigt(BaseModel):
    """F = k x + c v while x > 0."""

    name = "kelvin_voigt"
    channels = frozenset({ChannelKind.CONTACT})

    def build(self, context: ModelContext) -> Model:
        surface = (ContactOffset(),) if context.surface_found else ()
        return Model(self.name, (Stiffness(), Damping(), *surface))
