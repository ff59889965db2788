"""A joint that carries a constant inertia."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.inertia import Inertia
from estimation.effects.rate_dependence import ViscousFriction
from estimation.model import Model


class InertiaModel(BaseModel):
    """effort = m a + d v."""

    name = "inertia"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})

    def build(self, context: ModelContext) -> Model:
        return Model(self.name, (Inertia(), ViscousFriction()))
