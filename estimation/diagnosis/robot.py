"""Several channels of one robot, which tell on each other."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.common_cause import settle
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.result import ChannelDiagnosis
from estimation.diagnosis.true_force import sensor_faults, with_true_force
from estimation.effect import Effect
from estimation.model import Model

# Numbers of channels, and these as they are to be judged; the answers come in the same order.
Run = Callable[[Sequence[int], Sequence[ChannelData]], Sequence[ChannelDiagnosis]]


def judge_robot(
    channels: Sequence[ChannelData], models: Sequence[Model], effects: Sequence[Effect], run: Run
) -> list[Judged]:
    """Contacts first, then what carries their force; then all of them together.

    Args:
        channels: of one robot, as they were recorded.
        models: the base model of each.
        effects: the library of hypotheses.
        run: diagnoses channels, each by itself.

    Returns:
        One for each channel, in the order given; see `with_true_force` and `settle`.
    """
    judged: dict[int, Judged] = {}
    for is_contact in (True, False):
        numbers = [i for i, data in enumerate(channels) if (data.kind is ChannelKind.CONTACT) is is_contact]
        contacts = list(judged.values())
        made = [with_true_force(channels[i], contacts, effects) for i in numbers]
        for i, data, found in zip(numbers, made, run(numbers, made), strict=True):
            judged[i] = Judged(data, models[i], found)
    ordered = [judged[i] for i in range(len(channels))]
    faults = dict.fromkeys(name for one in ordered for name in sensor_faults(one, effects))
    answers = zip(channels, ordered, settle(ordered, effects), strict=True)
    return [
        replace(one, found=found if one.data is recorded else _corrected(found, list(faults)))
        for recorded, one, found in answers
    ]


def _corrected(found: ChannelDiagnosis, faults: Sequence[str]) -> ChannelDiagnosis:
    """The answer, which says that it is not about the force as it was measured."""
    said = f"judged by the force of the contact's model, ahead of the sensor's {' and '.join(faults)}"
    return found.model_copy(update={"reason": f"{found.reason}; {said}"})
