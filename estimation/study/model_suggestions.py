"""Suggest another base model or independent runs if they explain a measurement better."""

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

_FAR_RATIO = 0.5  # ratio of held-out errors below which another base model is suggested
_EQUAL_RATIO = 1.02  # largest ratio to the error of a complete model at which another model fits equally well


def better_model(
    study: ModelStudy, channel: StudyChannel, max_error: float, parameters: int | None = None
) -> tuple[str, float] | None:
    """Return the base model that fits a channel best and its held-out error; None if the error is too large.

    Args:
        study: the measurement and its fits.
        channel: the channel with its present base model, which is excluded.
        max_error: upper limit of the held-out error [effort].
        parameters: largest number of parameters; None for any number.
    """
    suitable = []
    for name in MODELS:
        if name == channel.model.name or channel.kind not in MODELS[name].channels:
            continue
        try:
            variant = study.with_model(channel.name, name)
            error = study.fit(variant).rmse
        except InputError:  # the model lacks information, such as a URDF
            continue
        count = len(variant.model.gains) + len(variant.model.inner)
        if error < max_error and count <= (parameters or count):
            suitable.append((name, error))
    return min(suitable, key=lambda model_and_error: model_and_error[1], default=None)


def far_better_model(
    study: ModelStudy, channel: StudyChannel, usual: Comparison | None
) -> tuple[str, float] | None:
    """Return a base model that fits far better than the usual one, and its held-out error.

    The result is None unless the error of the usual model is far above the noise.

    Args:
        study: the measurement and its fits.
        channel: the channel with the usual base model.
        usual: comparison of the usual model; None if the channel cannot be fitted.
    """
    if usual is None or usual.lack_of_fit < FAR:
        return None
    return better_model(study, channel, _FAR_RATIO * usual.rmse)


def better_explanation(
    study: ModelStudy, channel: StudyChannel, diagnosis: ChannelDiagnosis
) -> tuple[str, float] | None:
    """Return a base model that explains the channel far better than the usual one, and its held-out error.

    It must fit far better than the usual model with accepted effects. If these effects complete the usual
    model, this is impossible: the other model must then fit far better than the usual model alone, and as
    well as the complete model with no more parameters.

    Args:
        study: the measurement and its fits.
        channel: the channel with the usual base model.
        diagnosis: the diagnosis of this channel.
    """
    base, final = diagnosis.baseline, diagnosis.final
    if base is None or final is None or diagnosis.verdict is Verdict.ADEQUATE:
        return None
    if diagnosis.verdict is Verdict.UNEXPLAINED or diagnosis.complete is False:
        return better_model(study, channel, _FAR_RATIO * final.rmse)
    max_error = min(_FAR_RATIO * base.rmse, _EQUAL_RATIO * final.rmse)
    return better_model(study, channel, max_error, len(final.parameters))


_FRESH_RATIO = 0.95  # ratio of held-out errors below which independent runs are suggested


def with_clock_per_run(data: ChannelData) -> ChannelData:
    """Restart the clock of a channel in each run, so that all runs are independent.

    Args:
        data: the channel.
    """
    return replace(data, time_s=time_in_run(data.time_s, data.run))


def prefers_fresh_runs(data: ChannelData, model: Model) -> bool:
    """Return whether relaxation fits better if each run presses a fresh object instead of the same one.

    Args:
        data: a contact channel; the result is false for other channels.
        model: the model, with or without relaxation.
    """
    independent = with_clock_per_run(data)
    if data.kind is not ChannelKind.CONTACT or (independent.time_s == data.time_s).all():
        return False
    relaxing = model.without(StressRelaxation.name).with_effect_first(StressRelaxation())
    one_clock, own_clocks = (fit_base(channel, relaxing).rmse for channel in (data, independent))
    return own_clocks < _FRESH_RATIO * one_clock


def suggests_fresh_runs(study: ModelStudy, diagnosis: ChannelDiagnosis) -> bool:
    """Return whether a diagnosis with relaxation is incomplete, and independent runs would fit better.

    Args:
        study: the measurement and its fits.
        diagnosis: diagnosis of one of its channels.
    """
    named = [entry.effect for entry in diagnosis.accepted]
    unexplained = diagnosis.verdict is Verdict.UNEXPLAINED or diagnosis.complete is False
    if StressRelaxation.name not in named or not unexplained:
        return False
    channel = study.channel(diagnosis.channel)
    return prefers_fresh_runs(channel.data, channel.model)
