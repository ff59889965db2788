"""Suggest another base model, or runs on fresh objects, if these explain a measurement better."""

from dataclasses import replace

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.effects.time_memory import StressRelaxation
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.signals.blocks import time_in_run
from palpate.estimation.study.channels import StudyChannel
from palpate.estimation.study.comparison import FAR, Comparison
from palpate.estimation.study.fitting import fit_base
from palpate.estimation.study.study import ModelStudy
from palpate.robot_io.errors import InputError

_FAR_BETTER = 0.5  # ratio of held-out errors below which another base model is suggested
_NO_WORSE = 1.02  # ratio to the error of a complete model


def better_model(
    study: ModelStudy, channel: StudyChannel, most: float, parameters: int | None = None
) -> tuple[str, float] | None:
    """Return the base model that fits a channel best and its held-out error; None if above the limit.

    Args:
        study: study of the measurement.
        channel: with the model that was taken, for nobody named one.
        most: error that it may leave.
        parameters: largest number of parameters; None for any number.
    """
    good = []
    for name in MODELS:
        if name == channel.model.name or channel.kind not in MODELS[name].channels:
            continue
        try:
            variant = study.with_model(channel.name, name)
            error = study.fit(variant).rmse
        except InputError:  # it lacks something, such as a URDF
            continue
        count = len(variant.model.gains) + len(variant.model.inner)
        if error < most and count <= (parameters or count):
            good.append((name, error))
    return min(good, key=lambda tried: tried[1], default=None)


def far_better_model(
    study: ModelStudy, channel: StudyChannel, usual: Comparison | None
) -> tuple[str, float] | None:
    """Return the base model that fits far better than one that is far off, and its held-out error.

    Args:
        study: study of the measurement.
        channel: with the usual base model.
        usual: comparison of that model; None if the data cannot be judged.
    """
    if usual is None or usual.lack_of_fit < FAR:
        return None
    return better_model(study, channel, _FAR_BETTER * usual.rmse)


def better_explanation(
    study: ModelStudy, channel: StudyChannel, diagnosis: ChannelDiagnosis
) -> tuple[str, float] | None:
    """Return a base model that does far better than the usual one with accepted effects, and its error.

    If accepted effects complete the usual model, no other model can fit far better: then the other must fit
    as well with no more parameters than both together.

    Args:
        study: the measurement and its fits.
        channel: with the usual base model.
        diagnosis: the diagnosis of that model.
    """
    base, final = diagnosis.baseline, diagnosis.final
    if base is None or final is None or diagnosis.verdict is Verdict.ADEQUATE:
        return None
    if diagnosis.verdict is Verdict.UNEXPLAINED or diagnosis.complete is False:
        return better_model(study, channel, _FAR_BETTER * final.rmse)
    most = min(_FAR_BETTER * base.rmse, _NO_WORSE * final.rmse)
    return better_model(study, channel, most, len(final.parameters))


_BETTER = 0.95  # ratio of held-out errors below which independent runs are suggested


def on_clocks_of_their_own(data: ChannelData) -> ChannelData:
    """Restart the clock of a channel in each run, so that no run continues another.

    Args:
        data: the channel.
    """
    return replace(data, time_s=time_in_run(data.time_s, data.run))


def relaxes_afresh(data: ChannelData, model: Model) -> bool:
    """Check whether an object that relaxes, and is new to each run, explains more than the same object.

    Args:
        data: a contact channel; there is no suggestion for other channels.
        model: all that is known of it but relaxation, or with it.
    """
    afresh = on_clocks_of_their_own(data)
    if data.kind is not ChannelKind.CONTACT or (afresh.time_s == data.time_s).all():
        return False
    relaxing = model.without(StressRelaxation.name).with_effect_first(StressRelaxation())
    one_clock, own_clocks = (fit_base(way, relaxing).rmse for way in (data, afresh))
    return own_clocks < _BETTER * one_clock


def explained_by_fresh_runs(study: ModelStudy, diagnosis: ChannelDiagnosis) -> bool:
    """Check whether relaxation is only partly explained, and would be fully if runs were independent.

    Args:
        study: the measurement and its fits.
        diagnosis: diagnosis of one of its channels.
    """
    named = [entry.effect for entry in diagnosis.accepted]
    unexplained = diagnosis.verdict is Verdict.UNEXPLAINED or diagnosis.complete is False
    if StressRelaxation.name not in named or not unexplained:
        return False
    channel = study.channel(diagnosis.channel)
    return relaxes_afresh(channel.data, channel.model)
