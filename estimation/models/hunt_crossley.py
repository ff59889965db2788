"""The nonlinear contact model."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.contact_geometry import ContactOffset
from estimation.effects.rate_dependence import HuntCrossley
from estimation.model import Model


class HuntCrossleyModel(BaseModel):
    """F = k x^n + b x^n v while x > 0."""

    name = "hunt_crossley"
    channels = frozenset({ChannelKind.CONTACT})

    def build(self, context: ModelContext) -> Model:
        surface = (ContactOffset(),) if context.surface_found else ()
        return Model(self.name, (HuntCrossley(), *surface))
