"""Whether another base model would do far better than the usual one."""

from collections.abc import Iterator

from estimation.models import MODELS
from estimation.revision import standings
from palpate.findings.estimation_run import Arm
from palpate.findings.subject import Subject, subject_of
from robot_io.errors import InputError

FAR_BETTER = 0.5  # of the error in held-out runs


def better_model(subject: Subject, rmse: float, arm: Arm) -> tuple[str, float] | None:
    """The base model that fits this channel best, with its error, if that is less than half.

    Args:
        subject: the channel with the model that was taken, for nobody named one.
        rmse: what that leaves in held-out runs.
        arm: what the channel belongs to.
    """
    name, least = min(_others(subject, arm), key=lambda tried: tried[1], default=("", rmse))
    return (name, least) if least < FAR_BETTER * rmse else None


def _others(subject: Subject, arm: Arm) -> Iterator[tuple[str, float]]:
    for name in MODELS:
        if name == subject.model.name or subject.channel.kind not in MODELS[name].channels:
            continue
        try:
            other = subject_of(subject.channel, name, arm)
            (standing,) = standings(other.channel, other.model, ())
        except InputError:  # it lacks something, such as a URDF
            continue
        yield name, standing.rmse
