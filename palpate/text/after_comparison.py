"""What to type after a comparison of base models with the measurement."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from estimation.comparison import Comparison
from palpate.findings.compared import Wanted
from palpate.findings.estimation_run import Arm
from palpate.findings.other_models import better_model
from palpate.findings.subject import ALL_CHANNELS, Subject, channels_to_diagnose
from palpate.render.view import NOISE

FAR = 3.0  # times the noise floor
Compared = Sequence[tuple[Wanted, Comparison]]


@dataclass(frozen=True)
class Ways:
    """What there is to go on from.

    Attributes:
        grown: the command that compares what was added since, if anything was.
        other: what follows `palpate compare` for another base model; None where the user has named one.
        diagnose: what follows the name of that command.
        channel: the only one that the user asked for.
    """

    grown: str | None
    other: str | None
    diagnose: str
    channel: str | None


def after_comparison(
    subjects: tuple[Subject, ...], compared: Compared, arm: Arm, ways: Ways
) -> list[tuple[str, str]]:
    """Commands that go on from a comparison, each with what it is for; the nearest first.

    Args:
        subjects: all that was asked for.
        compared: those of them that could be compared.
        arm: what they belong to.
        ways: what there is to go on from.
    """
    if ways.grown is not None:
        first = [(ways.grown, "with what was added since")]
    else:
        first = list(_other_models(compared, arm, ways.other)) if ways.other is not None else []
    missing = f"palpate diagnose {ways.diagnose}{_where(subjects, compared, ways.channel)}"
    return [*first, (missing, "which effect is missing")]


def _other_models(compared: Compared, arm: Arm, typed: str) -> Iterator[tuple[str, str]]:
    """Commands with a base model that does far better, where the usual one misses by far."""
    for one, comparison in compared:
        far = comparison.lack_of_fit > FAR
        better = better_model(one.subject, comparison.rmse, arm) if far else None
        if better is not None:
            left = f"{better[1]:.3g} {comparison.effort_unit}"
            yield f"palpate compare {typed} --model {better[0]}", f"a base model that leaves {left}"


def _where(subjects: tuple[Subject, ...], compared: Compared, channel: str | None) -> str:
    """The option without which `diagnose` would not judge a channel that the model misses."""
    judged = {subject.channel.name for subject in channels_to_diagnose(subjects, None)}
    missed = [found.channel for _, found in compared if found.lack_of_fit >= NOISE]
    if channel is not None or judged.issuperset(missed):
        return ""
    return f" --channel {missed[0] if len(missed) == 1 else ALL_CHANNELS}"
