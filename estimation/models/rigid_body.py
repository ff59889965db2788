"""An arm whose masses are those of its URDF."""

from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.effects.gravity_load import KnownRigidBody
from estimation.model import Model
from estimation.models.arm import arm_of
from estimation.signals.arm_signals import with_rigid_body


class RigidBodyModel(BaseModel):
    """tau = M(q) a + C(q, v) v + g(q), nothing free: a payload or a wrong mass shows."""

    name = "rigid_body"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})

    def build(self, context: ModelContext) -> Model:
        arm_of(context, self.name)
        return Model(self.name, (KnownRigidBody(),))

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        return with_rigid_body(data, *arm_of(context, self.name))
