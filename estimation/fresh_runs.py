"""Whether each run met an object that had never been pressed, or one that still remembered the run before."""

from dataclasses import replace

from estimation.channel import ChannelData, ChannelKind
from estimation.effects.time_memory import StressRelaxation
from estimation.model import Model
from estimation.signals.blocks import time_in_run
from estimation.study.fitting import fit_base

_BETTER = 0.95  # of the error in held-out runs, that another way to count must leave at most


def on_clocks_of_their_own(data: ChannelData) -> ChannelData:
    """The channel with a clock that begins anew in each run: none is another's sequel."""
    return replace(data, time_s=time_in_run(data.time_s, data.run))


def relaxes_afresh(data: ChannelData, model: Model) -> bool:
    """Whether an object that relaxes, and was new to each run, explains more than one that was not.

    Args:
        data: a contact; of any other channel nothing is said.
        model: all that is known of it but relaxation, or with it.
    """
    afresh = on_clocks_of_their_own(data)
    if data.kind is not ChannelKind.CONTACT or (afresh.time_s == data.time_s).all():
        return False
    relaxing = model.without(StressRelaxation.name).with_effect_first(StressRelaxation())
    one_clock, own_clocks = (fit_base(way, relaxing).rmse for way in (data, afresh))
    return own_clocks < _BETTER * one_clock
