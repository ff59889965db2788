"""Spring and damper in parallel: the paper's contact model."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.contact_geometry import ContactOffset
from estimation.effects.elastic_shape import Stiffness
from estimation.effects.rate_dependence import Damping
from estimation.model import Model


class KelvinVoigt(BaseModel):
    """F = k x + c v while x > 0."""

    name = "kelvin_voigt"
    channels = frozenset({ChannelKind.CONTACT})

    def build(self, context: ModelContext) -> Model:
        surface = (ContactOffset(),) if context.surface_found else ()
        return Model(self.name, (Stiffness(), Damping(), *surface))
