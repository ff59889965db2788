"""Checks before fitting: reject unusable data and warn of implausible data.

Data are rejected only if nothing can be computed, or if signals contradict each other. Each message states
the value and the remedy, such as the option that overrides an assumption.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData
from palpate.estimation.data.units import MIN_STEP_S
from palpate.estimation.data_quality import motion_and_effort, readings, sampling
from palpate.estimation.fit.blocks import block_average, block_length
from palpate.estimation.fit.normal_equations import ORDER, ArNoise
from palpate.estimation.model import Model
from palpate.estimation.signals.runwise import apply_per_run, sample_time
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_GLITCH_RATIO = 25.0  # least ratio of a glitch to the median distance between neighboring readings
_MAX_GLITCHES = 0.01  # largest share of readings that are excluded as glitches
_MIN_SPIKE = 0.2  # size relative to the effort's range below which outliers are harmless
# Distance of a reading from its neighbors, relative to the range of all readings. Above `_CODE` it is a code
# for a missing value or a wrong digit. Above `_HUGE` even one that is excluded spoils the numerical precision
# of a fit (measured: 1e8).
_CODE, _HUGE = 20.0, 1e6


def usable(data: ChannelData) -> BoolArray:
    """Return the mask of samples that a fit may use, shape (n,).

    It excludes glitches (single readings far from both neighbors), runs that are copies of other runs, and
    readings of a contact that the sensor rectified or clipped in free air.

    Args:
        data: the channel, n samples.
    """
    if len(data) == 0:
        return np.ones(0, dtype=np.bool_)
    good = ~_glitches(data.effort, data.run)
    if np.mean(~good) > _MAX_GLITCHES:
        good = np.ones(len(data), dtype=np.bool_)
    return (
        good
        & ~np.isin(data.run, list(readings.copied_runs(data)))
        & ~readings.at_lower_end(data)
        & ~readings.folded_in_contact(data)
    )


def reject_reason(data: ChannelData) -> str | None:
    """Return the reason why a channel cannot be diagnosed, and the remedy.

    Args:
        data: the channel.

    Returns:
        One sentence, or None if the channel can be diagnosed.
    """
    if reason := _corrupted(data):
        return reason
    good = usable(data)
    return _first_reason((check for _, check in _REJECTED), data.select(good)) or _check_blocks(data, good)


def quality_warnings(data: ChannelData, model: Model | None = None) -> list[str]:
    """Return warnings about implausible data in a usable channel.

    Args:
        data: the channel.
        model: the base model, if known. A model without free parameters predicts the effort beyond a sensor's
            range, so saturation causes no warning.

    Returns:
        Sentences with values and with the options that override assumptions.
    """
    return [warning for _, warning in _warnings(data, model)]


def list_warnings(warnings: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Return each warning once, after the names of all channels that have it.

    Args:
        warnings: name and warnings of each channel.
    """
    channels: dict[str, list[str]] = {}
    for name, several in warnings:
        for warning in several:
            channels.setdefault(warning, []).append(name)
    return [f"{', '.join(names)}: {warning}" for warning, names in channels.items()]


def contaminated(data: ChannelData, model: Model) -> str | None:
    """Describe a fault of readings or motion, irrespective of the number of runs.

    Unlike `reject_reason`, the function does not require runs to hold out. It includes warnings about
    readings and times, but not about units.

    Args:
        data: the channel.
        model: the base model.

    Returns:
        One sentence, or None if there is no fault.
    """
    if reason := _corrupted(data):
        return reason
    good = data.select(usable(data))
    checks = (check for kind, check in _REJECTED if kind != "enough")
    kinds = {"sync", "readings", "saturation"}
    affected = (warning for kind, warning in _warnings(data, model) if kind in kinds)
    return _first_reason(checks, good) or next(affected, None)


def checklist(data: ChannelData, model: Model | None = None) -> dict[str, str]:
    """Return the rejection reason or warning of each kind of check.

    Args:
        data: the channel.
        model: the base model, if known.

    Returns:
        Sentence by kind of check ("enough" data, "units" and times, "sync" of effort and motion,
        "excitation", "readings", "saturation"), empty if the check passes. If the checks "enough" or "units"
        fail, the later checks are omitted.
    """
    kinds = ("enough", "units", "sync", "excitation", "readings", "saturation")
    if reason := _corrupted(data):
        return dict.fromkeys(kinds, "") | {"readings": reason}
    good, result = usable(data), dict[str, str]()
    selected = data.select(good)
    for kind in kinds:
        result[kind] = _first_reason((check for group, check in _REJECTED if group == kind), selected) or ""
        if kind in {"enough", "units"} and result[kind]:
            return result
    result["excitation"] = result["excitation"] or _check_blocks(data, good) or ""
    for kind, warning in _warnings(data, model):
        result[kind] = result[kind] or warning
    return result


def _warnings(data: ChannelData, model: Model | None) -> Iterator[tuple[str, str]]:
    """Yield the kind of check and the text of each warning."""
    if len(data) < sampling.MIN_SAMPLES or _corrupted(data) or readings.unchanging(data):
        return
    if copies := readings.copied_runs(data):
        yield "enough", readings.copied(copies)
    # Warn of many outliers, which are scored, and of huge ones, which are excluded.
    for name, signal in (("position", data.position), ("effort", data.effort)):
        glitches = _glitches(signal, data.run)
        if np.mean(glitches) > _MAX_GLITCHES:
            reason = _describe_outliers(data, name, glitches)
            yield "readings", f"{reason}; if they are lost readings, remove such rows"
    glitches = _glitches(data.effort, data.run)
    if glitches.any() and np.mean(glitches) <= _MAX_GLITCHES:
        size, regular = np.abs(data.effort), data.effort[~glitches]
        # Outliers within the usual range, such as dropouts to zero, cause no warning.
        beyond = glitches & (size > np.abs(regular).max() + np.ptp(regular))
        if beyond.any():
            reason = _describe_outliers(data, "effort", beyond)
            yield "enough", f"{reason}; diagnosis and comparison exclude such readings"
    for kind, warning in (("readings", readings.folded(data)), ("saturation", readings.stuck_in_air(data))):
        if warning:
            yield kind, warning
    good = data.select(usable(data))
    if len(good) < sampling.MIN_SAMPLES:
        return
    results = [(kind, check(good)) for kind, check in _IMPLAUSIBLE]
    results += [(kind, check(good, model)) for kind, check in _IMPLAUSIBLE_WITH_MODEL]
    yield from ((kind, warning) for kind, warning in results if warning)


def _distance_from_median(signal: FloatArray, run: IntArray) -> tuple[FloatArray, float]:
    """Return the distances (n,) of readings from their running medians, and the range of the medians."""
    smooth = apply_per_run(lambda values: np.asarray(scipy.ndimage.median_filter(values, 5)), signal, run)
    return np.abs(signal - smooth), float(np.ptp(smooth))


def _glitches(signal: FloatArray, run: IntArray) -> BoolArray:
    """Return the mask (n,) of single readings that are far from both neighbors."""
    distance, extent = _distance_from_median(signal, run)
    typical = float(np.median(distance[distance > 0.0])) if (distance > 0.0).any() else 0.0
    return np.asarray(distance > max(_GLITCH_RATIO * typical, _MIN_SPIKE * extent))


def _corrupted(data: ChannelData) -> str | None:
    """Reject outliers that a fit cannot exclude: in the position, too many, or too large."""
    if len(data) < sampling.MIN_SAMPLES:
        return None
    for name, signal in (("position", data.position), ("effort", data.effort)):
        distance, extent = _distance_from_median(signal, data.run)
        is_code = distance > _CODE * extent
        is_bad = is_code.any() if name == "position" else np.mean(is_code) > _MAX_GLITCHES
        if extent > 0.0 and (is_bad or (distance > _HUGE * extent).any()):
            return f"{_describe_outliers(data, name, is_code)}; remove such rows, or leave their cells empty"
    return None


def _describe_outliers(data: ChannelData, name: str, rows: BoolArray) -> str:
    """Count the readings that are far from their neighbors, and describe the first one."""
    first, number = int(np.argmax(rows)), int(np.count_nonzero(rows))
    unit = data.effort_unit if name == "effort" else data.position_unit
    signal = data.effort if name == "effort" else data.position
    count = f"1 reading of the {name} is" if number == 1 else f"{number} readings of the {name} are"
    example = f"{signal[first]:.6g} {unit} at {data.time_s[first]:.6g} s"
    return f"{count} far from {'its' if number == 1 else 'their'} neighbors, such as {example}"


def _check_blocks(data: ChannelData, good: BoolArray) -> str | None:
    """Require enough blocks to fit, and enough blocks in another run to hold out.

    Blocks are formed as in the fit. Each block in use must follow as many blocks of its run as the order of
    the noise model.
    """
    least, lengths = block_length(data), np.unique(data.run[good], return_counts=True)[1]
    parts = lengths // least if len(lengths) == 1 else lengths >= least
    if parts.sum() < 2:
        step_s = sample_time(data.time_s, data.run)
        unit = f", or check the unit of time: samples are {step_s:.2g} s apart"
        reason = f"at least two runs must have {least} samples or more; record longer runs"
        return reason + (unit if step_s < MIN_STEP_S else "")
    blocked = block_average(data, good)
    if not blocked.can_hold_out:
        if not good.all() and block_average(data).can_hold_out:
            return (
                f"{np.count_nonzero(~good)} readings are excluded, such as isolated ones far from their "
                "neighbors, so at most one run is left to fit; remove such rows, or record more runs"
            )
        return "at most one run has motion, so no run can be held out; record more runs"
    if len(np.unique(blocked.fold[ArNoise(np.zeros(ORDER)).used(blocked.run, blocked.trusted)])) < 2:
        return f"at least two runs must last {(ORDER + 1) * least} samples or more; record longer runs"
    return None


_Check = Callable[[ChannelData], str | None]  # returns the reason or warning; None if the data pass
_REJECTED: tuple[tuple[str, _Check], ...] = (  # kind and check, in the order used by `reject_reason`
    ("enough", sampling.wrong_size),
    ("excitation", readings.unchanging),
    ("excitation", motion_and_effort.at_rest),
    ("enough", sampling.no_shared_depth),
    ("units", motion_and_effort.mistaken_times),
    ("excitation", motion_and_effort.no_contact),
    ("excitation", motion_and_effort.tilted),
    ("readings", readings.too_coarse),
    ("readings", readings.rectified),
)
_IMPLAUSIBLE: tuple[tuple[str, _Check], ...] = (
    ("enough", sampling.never_repeated),
    ("units", motion_and_effort.mistaken_units),
    ("sync", motion_and_effort.misaligned),
    ("sync", sampling.lost_rows),
    ("excitation", sampling.single_speed),
    ("excitation", motion_and_effort.unrelated),
    ("excitation", motion_and_effort.late_touch),
    ("readings", readings.unsigned),
)
_IMPLAUSIBLE_WITH_MODEL: tuple[tuple[str, Callable[[ChannelData, Model | None], str | None]], ...] = (
    ("saturation", readings.saturated),
    ("units", motion_and_effort.angle_in_degrees),
    ("excitation", motion_and_effort.unresolved_inertia),
    ("sync", sampling.time_offset),
)


def _first_reason(checks: Iterable[_Check], data: ChannelData) -> str | None:
    return next(filter(None, (check(data) for check in checks)), None)
