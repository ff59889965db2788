"""What the channels of an arm say about each other."""

from collections.abc import Iterator, Sequence
from math import hypot

from palpate.estimation.diagnosis.result import ChannelDiagnosis, ParameterValue

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
    by_channel = {entry.channel: _of_arm(entry) for entry in diagnosed}

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
    has_value = any(name.startswith(f"{effect}.") for name in _of_arm(entry))
    return has_value and any(each.effect == effect and not each.confused_with for each in entry.accepted)


def is_shared(effect: str, entry: ChannelDiagnosis, diagnosed: Sequence[ChannelDiagnosis]) -> bool:
    """Return whether a channel names an effect of the arm with values that agree with other channels.

    Args:
        effect: name of the effect.
        entry: diagnosis of the channel.
        diagnosed: diagnoses of all channels of the recording.
    """
    own = {name: value for name, value in _of_arm(entry).items() if name.startswith(f"{effect}.")}
    pairs = [
        (own[name], value)
        for other in diagnosed
        if other.channel != entry.channel
        for name, value in _of_arm(other).items()
        if name in own
    ]
    return bool(pairs) and not any(_differ(*pair) for pair in pairs)


def _of_arm(entry: ChannelDiagnosis) -> dict[str, ParameterValue]:
    parameters = entry.final.parameters if entry.final else {}
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
