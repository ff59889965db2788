"""Whether another base model would do far better than the usual one."""

from collections.abc import Iterable, Iterator

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.models import MODELS
from estimation.revision import standings
from palpate.findings.estimation_run import Arm
from palpate.findings.subject import Subject, subject_of
from robot_io.errors import InputError

FAR_BETTER = 0.5  # of the error in held-out runs
_NO_WORSE = 1.02  # times the error of a model that is complete
_Other = tuple[str, float, int]  # name, error in held-out runs, number of parameters


def better_model(subject: Subject, rmse: float, arm: Arm) -> tuple[str, float] | None:
    """The base model that fits this channel best, with its error, if that is less than half.

    Args:
        subject: the channel with the model that was taken, for nobody named one.
        rmse: what that leaves in held-out runs.
        arm: what the channel belongs to.
    """
    return _best(other for other in _others(subject, arm) if other[1] < FAR_BETTER * rmse)


def better_explanation(subject: Subject, found: ChannelDiagnosis, arm: Arm) -> tuple[str, float] | None:
    """The base model that does far better than the usual one with what was found missing, and its error.

    Where the effects found complete the usual model, no other can fit far better: then it must fit as well
    with no more parameters than both together have.

    Args:
        subject: the channel with the model that was taken, for nobody named one.
        found: what was found missing in that.
        arm: what the channel belongs to.
    """
    base, final = found.baseline, found.final
    if base is None or final is None or found.verdict is Verdict.ADEQUATE:
        return None
    if found.verdict is Verdict.UNEXPLAINED:
        return better_model(subject, final.rmse, arm)
    most = min(FAR_BETTER * base.rmse, _NO_WORSE * final.rmse)
    others = _others(subject, arm)
    return _best(other for other in others if other[1] < most and other[2] <= len(final.parameters))


def _best(others: Iterable[_Other]) -> tuple[str, float] | None:
    best = min(others, key=lambda tried: tried[1], default=None)
    return None if best is None else best[:2]


def _others(subject: Subject, arm: Arm) -> Iterator[_Other]:
    for name in MODELS:
        if name == subject.model.name or subject.channel.kind not in MODELS[name].channels:
            continue
        try:
            other = subject_of(subject.channel, name, arm)
            (standing,) = standings(other.channel, other.model, ())
        except InputError:  # it lacks something, such as a URDF
            continue
        yield name, standing.rmse, len(other.model.gains) + len(other.model.inner)
