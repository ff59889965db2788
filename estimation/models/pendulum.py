"""A joint that swings a body under gravity."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.pendulum import Pendulum
from estimation.effects.viscous_friction import ViscousFriction
from estimation.model import Model


class PendulumModel(BaseModel):
    """torque = J a + g1 sin(q) + d v, q = 0 hanging straight down."""

    name = "pendulum"
    channels = frozenset({ChannelKind.REVOLUTE})

    def build(self, context: ModelContext) -> Model:
        return Model(self.name, (Pendulum(), ViscousFriction()))
