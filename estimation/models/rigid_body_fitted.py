"""An arm whose masses are found from the data."""

from estimation.arm.base_parameters import base_parameters
from estimation.base_model import BaseModel, ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.effects.gravity_load import RigidBodyFitted
from estimation.effects.rate_dependence import ViscousFriction
from estimation.model import Model
from estimation.models.arm import arm_of
from estimation.signals.arm_signals import with_rigid_body


class RigidBodyFittedModel(BaseModel):
    """tau = Y(q, v, a) pi + d v, with the arm's base parameters pi, as far as the joint feels them."""

    name = "rigid_body_fitted"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})

    def build(self, context: ModelContext) -> Model:
        body, joint = arm_of(context, self.name)
        arm = base_parameters(body)
        felt = tuple(arm.felt_columns(joint).tolist())
        return Model(self.name, (RigidBodyFitted(felt, arm, body.parameters), ViscousFriction()))

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        return with_rigid_body(data, *arm_of(context, self.name), regressor=True)
