"""An arm whose masses are those of its URDF."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.effects.rigid_body import RigidBody
from estimation.model import Model
from estimation.models.arm import arm_of
from estimation.signals.arm_signals import with_rigid_body


class RigidBodyModel(BaseModel):
    """tau = ID(q, v, a), nothing free: a payload or a wrong mass shows."""

    name = "rigid_body"
    physics = "The links' masses load the joint as the URDF says."
    equation = "tau = M(q) a + C(q, v) v + g(q)"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})

    def build(self, context: ModelContext) -> Model:
        arm_of(context, self.name)
        return Model(self.name, (RigidBody(),))

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        return with_rigid_body(data, *arm_of(context, self.name))
