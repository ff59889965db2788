"""Base models of contacts and of spring-mass-damper systems."""

from dataclasses import replace

import numpy as np

from palpate.estimation.base_model import BaseModel, ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effects.elastic_shape import Stiffness
from palpate.estimation.effects.inertia import Inertia
from palpate.estimation.effects.rate_dependence import Damping, HuntCrossley
from palpate.estimation.statistics.correlation import correlation_coefficient


class KelvinVoigt(BaseModel):
    """F = k x + c v while x > 0."""

    name = "kelvin_voigt"
    channels = frozenset({ChannelKind.CONTACT})
    effects = (Stiffness, Damping)


class HuntCrossleyModel(BaseModel):
    """F = k x^n + b x^n v while x > 0."""

    name = "hunt_crossley"
    channels = frozenset({ChannelKind.CONTACT})
    effects = (HuntCrossley,)


_MIN_CORRELATION = 0.5  # least correlation of force and displacement outside the object of an attached spring


class SpringMassDamper(BaseModel):
    """F = m a + c v + k x; the force can also pull, as with a spring that is attached at both ends."""

    name = "spring_mass_damper"
    channels = frozenset(ChannelKind)
    effects = (Inertia, Damping, Stiffness)

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        """Mark all samples as in contact if the force outside the object follows the position."""
        is_outside = data.position < 0.0
        x, force = data.position[is_outside], data.effort[is_outside]
        is_contact = data.kind is ChannelKind.CONTACT
        if is_contact and len(x) >= 3 and correlation_coefficient(x, force) > _MIN_CORRELATION:
            return replace(data, touching=np.ones(len(data), dtype=np.bool_))
        return data
