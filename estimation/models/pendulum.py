"""A joint that swings a body under gravity."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.gravity_load import Pendulum
from estimation.effects.rate_dependence import ViscousFriction
from estimation.model import Model


class PendulumModel(BaseModel):
    """torque = J a + g1 sin(q) + d v, q = 0 hanging straight down."""

    name = "pendulum"
    channels = frozenset({ChannelKind.REVOLUTE})

    def build(self, context: ModelContext) -> Model:
        return Model(self.name, (Pendulum(), ViscousFriction()))
