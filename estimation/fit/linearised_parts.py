"""What of a model changes while one effect is searched, and what is computed once for all of it."""

from collections.abc import Callable, Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Effect, Inner, SensorEffect
from estimation.model import Model, Parts

LinearisedParts = Callable[[Inner], Parts | None]


def is_linear_on_blocks(data: ChannelData, model: Model) -> bool:
    """Whether a model can be fitted on blocks alone; a contact's effort is cut off sample by sample."""
    return model.is_sum and data.kind is not ChannelKind.CONTACT


def linearise_along(
    data: ChannelData, model: Model, effect: Effect, parameters: Mapping[str, float]
) -> LinearisedParts:
    """What gives `Model.parts` by the inner parameters of one effect; None where that saves nothing.

    Args:
        data: the channel.
        model: ends with the effect, unless that is a sensor's.
        effect: the one that is searched.
        parameters: inner parameters of the others; zero for one that is not there.
    """
    known = {name: parameters.get(name, 0.0) for name in model.inner}
    if isinstance(effect, SensorEffect):  # what comes before a sensor does not depend on it
        before = model.parts(data, known)
        return lambda inner: before
    if (
        not isinstance(effect, AdditiveEffect)
        or model.effects[-1] is not effect
        or is_linear_on_blocks(data, model)
    ):
        return lambda inner: None
    moved = model.moved(data, known)
    columns, effort = model.without(effect.name).parts(data, known)

    def parts(inner: Inner) -> Parts:
        own_columns = model.faded(
            effect,
            effect.columns(moved, inner),
            moved,
            {**known, **{f"{effect.name}.{n}": v for n, v in inner.items()}},
        )
        return np.concatenate([columns.T, own_columns.T]).T, effort + effect.known(moved, inner)

    return parts
