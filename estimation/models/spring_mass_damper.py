"""A mass on a spring and a damper."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelKind
from estimation.effects.damping import Damping
from estimation.effects.inertia import Inertia
from estimation.effects.stiffness import Stiffness
from estimation.model import Model


class SpringMassDamper(BaseModel):
    """F = m a + c v + k x, pulling as well as pushing: the spring is held at both ends."""

    name = "spring_mass_damper"
    physics = "A mass is held by a spring and a damper."
    equation = "F = m a + c v + k x"
    channels = frozenset({ChannelKind.PRISMATIC, ChannelKind.REVOLUTE})

    def build(self, context: ModelContext) -> Model:
        return Model(self.name, (Inertia(), Damping(), Stiffness()))
