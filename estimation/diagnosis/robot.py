"""Several channels of one robot, which tell on each other."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from estimation.channel import ChannelData
from estimation.diagnosis.common_cause import settle
from estimation.diagnosis.dead_band import with_dead_band
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.result import ChannelDiagnosis
from estimation.diagnosis.true_force import borne_out, sensor_faults, with_true_force
from estimation.effect import Effect
from estimation.model import Model

# Numbers of channels, these as they are to be judged, and their base models; the answers in the same order.
Run = Callable[[Sequence[int], Sequence[ChannelData], Sequence[Model]], Sequence[ChannelDiagnosis]]


def judge_robot(
    channels: Sequence[ChannelData], models: Sequence[Model], effects: Sequence[Effect], run: Run
) -> list[Judged]:
    """All at once; then again what carries a force whose sensor proved at fault; then all of them together.

    Last, contacts again under a dead band of their sensor that the joints showed.

    Args:
        channels: of one robot, as they were recorded.
        models: the base model of each.
        effects: the library of hypotheses.
        run: diagnoses channels, each by itself.

    Returns:
        One for each channel, in the order given; see `with_true_force` and `settle`.
    """
    everything = range(len(channels))
    ordered = [Judged(*one) for one in zip(channels, models, run(everything, channels, models), strict=True)]
    joints = [one for one in ordered if one.found.baseline is not None]
    ordered = [borne_out(one, joints, effects) for one in ordered]
    made = [with_true_force(data, ordered, effects) for data in channels]
    again = [i for i in everything if made[i] is not channels[i]]
    for i, found in zip(again, _again(run, again, made, models), strict=True):
        ordered[i] = Judged(made[i], models[i], found)
    faults = dict.fromkeys(name for one in ordered for name in sensor_faults(one, effects))
    answers = zip(channels, ordered, settle(ordered, effects), strict=True)
    told = [
        replace(one, found=found if one.data is recorded else _corrected(found, list(faults)))
        for recorded, one, found in answers
    ]
    return with_dead_band(told, effects, lambda i, data, model: run([i], [data], [model])[0])


def _again(
    run: Run, numbers: Sequence[int], made: Sequence[ChannelData], models: Sequence[Model]
) -> Sequence[ChannelDiagnosis]:
    return run(numbers, [made[i] for i in numbers], [models[i] for i in numbers]) if numbers else ()


def _corrected(found: ChannelDiagnosis, faults: Sequence[str]) -> ChannelDiagnosis:
    """The answer, which says that it is not about the force as it was measured."""
    said = f"judged by the force of the contact's model, ahead of the sensor's {' and '.join(faults)}"
    return found.model_copy(update={"reason": f"{found.reason}; {said}", "force_ahead_of": list(faults)})
