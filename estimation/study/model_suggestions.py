"""Whether another base model would do far better than the usual one."""

from collections.abc import Iterator

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.models import MODELS
from estimation.study.channels import StudyChannel
from estimation.study.study import ModelStudy
from robot_io.errors import InputError

FAR_BETTER = 0.5  # of the error in held-out runs
_NO_WORSE = 1.02  # times the error of a model that is complete


def better_model(
    study: ModelStudy, channel: StudyChannel, most: float, parameters: int | None = None
) -> tuple[str, float] | None:
    """The base model that fits a channel best, with its error in held-out runs; None if it is above the most.

    Args:
        study: what was measured.
        channel: with the model that was taken, for nobody named one.
        most: error that it may leave.
        parameters: that it may have; None for any number.
    """
    others = _others(study, channel)
    good = [(name, error) for name, error, count in others if error < most and count <= (parameters or count)]
    return min(good, key=lambda tried: tried[1], default=None)


def better_explanation(
    study: ModelStudy, channel: StudyChannel, found: ChannelDiagnosis
) -> tuple[str, float] | None:
    """The base model that does far better than the usual one with what was found missing, and its error.

    Where the effects found complete the usual model, no other can fit far better: then it must fit as well
    with no more parameters than both together have.

    Args:
        study: the measurement and its fits.
        channel: with the usual base model.
        found: the diagnosis of that model.
    """
    base, final = found.baseline, found.final
    if base is None or final is None or found.verdict is Verdict.ADEQUATE:
        return None
    if found.verdict is Verdict.UNEXPLAINED or found.complete is False:
        return better_model(study, channel, FAR_BETTER * final.rmse)
    most = min(FAR_BETTER * base.rmse, _NO_WORSE * final.rmse)
    return better_model(study, channel, most, len(final.parameters))


def _others(study: ModelStudy, channel: StudyChannel) -> Iterator[tuple[str, float, int]]:
    """Name, error in held-out runs, and number of parameters of all other models of such a channel."""
    for name in MODELS:
        if name == channel.model.name or channel.kind not in MODELS[name].channels:
            continue
        try:
            other = study.with_model(channel.name, name)
            error = study.fit(other).rmse
        except InputError:  # it lacks something, such as a URDF
            continue
        yield name, error, len(other.model.gains) + len(other.model.inner)
