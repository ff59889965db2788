"""What the tip really pushes with, where the force sensor was found to be at fault.

The joints carry the force itself, not what its sensor makes of it. A sensor's fault that was named in the
contact must not be looked for in the joints, so these are judged by the force that the contact's own model
gives ahead of its sensor.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.judged import Judged
from estimation.effect import Effect, SensorEffect
from estimation.model import Model
from estimation.signals.arm_signals import LEVER, TOUCH
from robot_io.types import FloatArray

_FORCE = "contact_force"
_OF_THE_ZERO = {"bias", "drift"}


def with_true_force(joint: ChannelData, contacts: Sequence[Judged], effects: Sequence[Effect]) -> ChannelData:
    """The joint's channel with the force that the contacts' models give, where a sensor's fault was named.

    Args:
        joint: as it was recorded; other channels are returned as they are.
        contacts: what was judged before it in the same session; all but contacts is passed over.
        effects: the library in which the effects that were found are.
    """
    if LEVER not in joint.context or not any(_sensors(contact, effects) for contact in contacts):
        return joint
    force_n = joint.context[_FORCE].copy()
    for contact in contacts:
        time_s = contact.data.time_s
        inside = (time_s[0] <= joint.time_s) & (joint.time_s <= time_s[-1])
        if _sensors(contact, effects):
            force_n[inside] = np.interp(joint.time_s[inside], time_s, _pushed(contact, effects))
    return replace(joint, context={**joint.context, _FORCE: force_n, TOUCH: joint.context[LEVER] * force_n})


def _sensors(contact: Judged, effects: Sequence[Effect]) -> list[Effect]:
    """Effects of the force sensor that were accepted in a contact."""
    if contact.data.kind is not ChannelKind.CONTACT:
        return []
    names = {entry.effect for entry in contact.found.accepted}
    return [effect for effect in effects if effect.name in names and isinstance(effect, SensorEffect)]


def _pushed(contact: Judged, effects: Sequence[Effect]) -> FloatArray:
    """The force of the object (n,), ahead of the sensor and without its zero."""
    names = {entry.effect for entry in contact.found.accepted}
    of_object = [effect for effect in effects if effect.name in names and not _is_reader(effect)]
    model = Model(contact.model.name, (*contact.model.effects, *of_object))
    fitted = contact.found.final.parameters if contact.found.final else {}
    return model.predict(contact.data, {name: fitted[name].value for name in (*model.gains, *model.inner)})


def _is_reader(effect: Effect) -> bool:
    """Whether an effect is in the reading alone: a sensor's, or an offset of its zero."""
    return isinstance(effect, SensorEffect) or effect.name in _OF_THE_ZERO
