"""What the tip really pushes with, where the force sensor was found to be at fault.

The joints carry the force itself, not what its sensor makes of it. A sensor's fault that was named in the
contact must not be looked for in the joints, so these are judged by the force that the contact's own model
gives ahead of its sensor.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.standing import stand
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.judgement.gate import usable
from estimation.diagnosis.result import Accepted, Verdict
from estimation.effect import Effect, SensorEffect
from estimation.model import Model
from estimation.signals.arm_signals import LEVER, TOUCH
from robot_io.types import FloatArray

_FORCE = "contact_force"
_OF_THE_ZERO = {"bias", "drift"}
_WANDERING = {"drift"}  # a zero that what is read in free air before a press does not tell
# Times a joint's error by the force as the sensor reads it: a fault worth believing takes a fifth off the
# squared error, and what differs by less than a tie of candidates is no worse.
_BETTER, _NO_WORSE = 0.9, 1.02


def with_true_force(joint: ChannelData, contacts: Sequence[Judged], effects: Sequence[Effect]) -> ChannelData:
    """The joint's channel with the force that the contacts' models give, where a sensor's fault was named.

    Each contact speaks for its own runs alone. One whose model is not complete says nothing of the force
    unless the joints bear it out, nor does one whose fault may as well be the object's: of that, the joints
    can tell.

    Args:
        joint: as it was recorded; other channels are returned as they are.
        contacts: what was judged before it in the same session; all but contacts is passed over.
        effects: the library in which the effects that were found are.
    """
    known = [contact for contact in contacts if sensor_faults(contact, effects)]
    if LEVER not in joint.context or not known:
        return joint
    return _carrying(joint, [(contact, _modelled(contact, effects, reading=False)) for contact in known])


def _carrying(joint: ChannelData, forces: Sequence[tuple[Judged, FloatArray]]) -> ChannelData:
    """The joint as if the tip pushed with these forces (n,) [N], each in the runs of its contact."""
    force_n = joint.context[_FORCE].copy()
    for contact, pushed_n in forces:
        for run in contact.data.runs:
            theirs = contact.data.run == run
            time_s = contact.data.time_s[theirs]
            ours = (joint.run == run) & (time_s[0] <= joint.time_s) & (joint.time_s <= time_s[-1])
            force_n[ours] = np.interp(joint.time_s[ours], time_s, pushed_n[theirs])
    return replace(joint, context={**joint.context, _FORCE: force_n, TOUCH: joint.context[LEVER] * force_n})


def sensor_faults(contact: Judged, effects: Sequence[Effect]) -> list[str]:
    """Faults of the force sensor that a contact shows, if it surely does: all of them, or none."""
    sure = contact.found.verdict is Verdict.MISSING or contact.borne_out
    return _named_faults(contact, effects) if sure else []


def borne_out(contact: Judged, joints: Sequence[Judged], effects: Sequence[Effect]) -> Judged:
    """The contact, marked if the joints bear out a fault of its sensor that it names above all.

    Where a contact is not explained in full, the fault that it names may be what something else looks like
    there. But the joints measure the force once more: their base models, which know nothing of that fault,
    must fit clearly better to the reading with that fault taken off it in one joint, and worse in none. The
    model's own force would fit better whatever the fault: it has no noise.
    """
    unsure = contact.found.verdict is Verdict.UNEXPLAINED
    if not unsure or not _named_faults(contact, effects):
        return contact
    swallowed_n = _modelled(contact, effects, reading=False) - _modelled(contact, effects, reading=True)
    mended_n = contact.data.effort + swallowed_n
    ratios = [
        _error(_carrying(one.data, [(contact, mended_n)]), one) / _error(one.data, one)
        for one in joints
        if LEVER in one.data.context
    ]
    clearly = bool(ratios) and min(ratios) < _BETTER and max(ratios) < _NO_WORSE
    return replace(contact, borne_out=True) if clearly else contact


def _error(data: ChannelData, joint: Judged) -> float:
    """What the joint's base model leaves in held-out runs."""
    return stand(data, joint.model, {}, usable(data)).rmse


def _named_faults(contact: Judged, effects: Sequence[Effect]) -> list[str]:
    if contact.data.kind is not ChannelKind.CONTACT:
        return []
    of_sensor = {effect.name for effect in effects if isinstance(effect, SensorEffect)} | _WANDERING
    faults = [entry for entry in contact.found.accepted if entry.effect in of_sensor]
    return [entry.effect for entry in faults] if all(_is_sure(entry, of_sensor) for entry in faults) else []


def _is_sure(fault: Accepted, of_sensor: set[str]) -> bool:
    return (of_sensor | _OF_THE_ZERO).issuperset(fault.confused_with)


def _modelled(contact: Judged, effects: Sequence[Effect], *, reading: bool) -> FloatArray:
    """The force of the object (n,), without the sensor's zero: as it is read, or ahead of the sensor."""
    names = {entry.effect for entry in contact.found.accepted}
    taken = [
        effect
        for effect in effects
        if effect.name in names
        and effect.name not in _OF_THE_ZERO
        and (reading or not isinstance(effect, SensorEffect))
    ]
    model = Model(contact.model.name, (*contact.model.effects, *taken))
    fitted = contact.found.final.parameters if contact.found.final else {}
    return model.predict(contact.data, {name: fitted[name].value for name in (*model.gains, *model.inner)})
