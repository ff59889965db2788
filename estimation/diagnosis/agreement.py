"""What the channels of an arm say about each other."""

from collections.abc import Iterator, Sequence
from math import hypot

from palpate.estimation.channel import ChannelData
from palpate.estimation.data_quality import usable
from palpate.estimation.diagnosis.candidates import applicable_effects
from palpate.estimation.diagnosis.result import ChannelDiagnosis, FitSummary, ParameterValue
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model

# Effects with parameters of the whole arm, and the unit of these. A pendulum's tilt, in N m, is not shared.
_OF_ARM = {"encoder_zero": "rad", "force_deadband": "N", "gravity_tilt": "rad", "payload": "kg"}
_SIGMAS, _SHARE = 4.0, 0.1  # values differ by more than this many standard errors and share of the larger


def with_cautions(diagnosed: Sequence[ChannelDiagnosis]) -> list[ChannelDiagnosis]:
    """State in each diagnosis what others of the same arm contradict or make doubtful.

    Each joint is diagnosed by itself, so an effect that stands for another one can fit each joint with other
    values. A true payload, tilt or encoder zero is the same in all joints. Wrong encoder zeros also shift and
    tilt the path of the tip, from which the depth of a contact is computed.

    Args:
        diagnosed: diagnoses of channels of one recording.
    """
    by_channel = {entry.channel: _of_arm(entry.final) for entry in diagnosed}

    def cautions(channel: str) -> Iterator[str]:
        wrong = [joint for joint, theirs in by_channel.items() if any(map(_is_wrong_zero, theirs.items()))]
        if channel.startswith("contact") and wrong:
            yield (
                f"{', '.join(wrong)}: encoder_zero is named, so the depth of this contact, and with it the "
                "stiffness, was computed from wrong angles; run palpate calibrate encoder and record again"
            )
        for name, own in by_channel[channel].items():
            others = [
                (theirs[name], joint)
                for joint, theirs in by_channel.items()
                if name in theirs and _differ(own, theirs[name])
            ]
            if others:
                other, joint = min(others, key=lambda pair: pair[0].std_err or 0.0)
                yield (
                    f"{name} is {_shown(own)} in {channel}, but {_shown(other)} in {joint}. All joints share "
                    "this value, so at least one of the two effects stands for another"
                )

    return [entry.model_copy(update={"cautions": list(cautions(entry.channel))}) for entry in diagnosed]


def replaceable_effects(diagnosed: Sequence[ChannelDiagnosis]) -> list[tuple[str, str, str]]:
    """List effects that an effect of the whole arm, shown by another channel, may replace.

    One cause of two errors is simpler than two causes.

    Args:
        diagnosed: diagnoses of channels of one recording.

    Returns:
        Channel, named effect, and the effect of the arm that the channel cannot distinguish from it and that
        another channel names without an alternative.
    """
    return [
        (entry.channel, each.effect, shared)
        for entry in diagnosed
        for each in entry.accepted
        for shared in each.confused_with
        if any(_shows(shared, other) for other in diagnosed if other.channel != entry.channel)
    ]


def _shows(effect: str, entry: ChannelDiagnosis) -> bool:
    """Return whether a channel names an effect of the arm, with its values, without an alternative."""
    return bool(_values(effect, entry.final)) and any(
        each.effect == effect and not each.confused_with for each in entry.accepted
    )


def is_shared(effect: str, entry: ChannelDiagnosis, diagnosed: Sequence[ChannelDiagnosis]) -> bool:
    """Return whether a channel names an effect of the arm with values that agree with other channels.

    Args:
        effect: name of the effect.
        entry: diagnosis of the channel.
        diagnosed: diagnoses of all channels of the recording.
    """
    own = _values(effect, entry.final)
    pairs = [
        (own[name], value)
        for other in diagnosed
        if other.channel != entry.channel
        for name, value in _of_arm(other.final).items()
        if name in own
    ]
    return bool(pairs) and not any(_differ(*pair) for pair in pairs)


def contradicted_effect(
    entry: ChannelDiagnosis,
    diagnosed: Sequence[ChannelDiagnosis],
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    library: Sequence[Effect],
) -> str | None:
    """Find an effect of the arm that one joint names, with an alternative, and another joint excludes.

    If the base is tilted for one joint, it is tilted for all. A joint in which nothing is missing excludes
    the effect if it gets another value there, and if no joint names it too. A joint that names another effect
    excludes nothing, because its effect may stand for the one of the arm.

    Args:
        entry: diagnosis of the joint.
        diagnosed: diagnoses of channels of one recording.
        channels: the channels, in the same order.
        models: their base models.
        library: the candidate effects.

    Returns:
        Name of the effect; None if there is none.
    """
    named = {each.effect for other in diagnosed if other.channel != entry.channel for each in other.accepted}
    for each in entry.accepted if entry.complete else []:
        own = _values(each.effect, entry.final)
        if not own or not each.confused_with or each.effect in named:
            continue
        for other, data, model in zip(diagnosed, channels, models, strict=True):
            if not other.complete or other.accepted or other.channel == entry.channel:
                continue
            for effect in applicable_effects(
                data, model, [known for known in library if known.name == each.effect]
            ):
                fit = FitSummary.of(fit_model(data, model.with_effect(effect), {}, usable(data)))
                theirs = _values(effect.name, fit)
                if any(_differ(own[name], value) for name, value in theirs.items() if name in own):
                    return each.effect
    return None


def _values(effect: str, fit: FitSummary | None) -> dict[str, ParameterValue]:
    """Return the determined parameters of the whole arm that one effect has in a fit."""
    return {name: value for name, value in _of_arm(fit).items() if name.startswith(f"{effect}.")}


def _of_arm(fit: FitSummary | None) -> dict[str, ParameterValue]:
    parameters = fit.parameters if fit else {}
    return {
        name: parameter
        for name, parameter in parameters.items()
        if _OF_ARM.get(name.partition(".")[0]) == parameter.unit and parameter.std_err
    }


def _is_wrong_zero(named: tuple[str, ParameterValue]) -> bool:
    name, offset = named
    return name.startswith("encoder_zero.") and abs(offset.value) > _SIGMAS * (offset.std_err or 0.0)


def _differ(own: ParameterValue, other: ParameterValue) -> bool:
    apart = abs(own.value - other.value)
    larger = max(abs(own.value), abs(other.value))
    return apart > _SHARE * larger and apart > _SIGMAS * hypot(own.std_err or 0.0, other.std_err or 0.0)


def _shown(parameter: ParameterValue) -> str:
    low, high = parameter.interval
    return f"{parameter.value:.3g} ± {0.5 * (high - low):.2g} {parameter.unit}"
