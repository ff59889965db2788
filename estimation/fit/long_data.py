"""Average recordings that are too long for a fast search, if this loses no information."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.blocks import BlockedData, block_length, decimate
from palpate.estimation.signals.blocks import blocks, rows_of_runs
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.types import IntArray

LONG = 500_000  # number of samples above which recordings are always averaged, and samples at rest dropped
_MAX_BLOCKS = 25_000  # largest number of blocks of a recording that needs no averaging
_MAX_SAMPLES = 100_000  # largest number of samples that are searched in acceptable time
_MAX_LOST = 0.1  # largest variance of a signal within a block, relative to the noise variance of its mean
_STANDARD_ERRORS = 3.0  # standard errors for that test
_MIN_IN_BLOCK = 4  # samples needed to tell noise from a signal by a third difference
_MIN_IN_RUN = 50  # least number of means in a run
_MIN_RUNS = 6  # runs that must remain, so that some can be held out
_MIN_PIECES = 40  # least number of pieces into which a joint's runs are cut
_MIN_COVERED = 0.3  # least share of the range of positions that each piece covers
# Largest share of the range of positions that a joint at rest covers within `_NEAR_S` on both sides.
_REST_RANGE = 0.002
_NEAR_S = 0.5  # time before and after a motion that belongs to it
_MOVING_SHARE = 0.5  # share of samples near a motion below which a joint is mostly at rest
_MAX_EXCESS = 2  # multiple of `_MAX_SAMPLES` above which some loss of information is accepted
_THIRD_DIFFERENCE = 20.0  # sum of the squares of (1, -3, 3, -1), the weights of a third difference


@dataclass(frozen=True)
class _BlockVariation:
    """Variation of an effort within blocks."""

    # Root mean square deviation from a straight line, corrected for the degrees of freedom of the line.
    departure: float
    noise: float  # standard deviation of the white noise, from third differences of consecutive samples
    count: int  # number of samples

    def is_noise(self, block: int) -> bool:
        """Return whether averaging `block` samples loses no relevant information, only noise.

        The squared departure from a straight line must not exceed that of the noise by more than a tenth of
        the noise variance of a block's mean, plus three standard errors.

        Args:
            block: number of samples whose mean replaces them.
        """
        error = _STANDARD_ERRORS * np.sqrt(4.6 / self.count)  # error of a mean of squared third differences
        return bool(self.departure**2 <= self.noise**2 * (1.0 + _MAX_LOST / block + error))


def shortened(data: ChannelData, held_out: Sequence[int] = ()) -> tuple[ChannelData, str, Mapping[int, int]]:
    """Shorten a long recording: average it over blocks, and select runs if it is still too long.

    A diagnosis works on blocks of 5 ms (10 ms for a joint's effort). The block length is doubled as long as
    the effort within blocks deviates from a straight line by no more than the white noise of its readings.
    Motion and effort then change linearly within a block, so that averages obey the same law as the samples
    and lose only noise. Slow noise counts as signal, which makes the sampling rate higher than necessary.

    If the result is still too long, evenly spread runs, or stretches of a joint's runs, are selected. If that
    is impossible, the data are averaged further with a loss of information. If a joint with more than `LONG`
    samples is mostly at rest, only its motions are used. The returned sentence describes these steps.

    Args:
        data: the channel; velocity and acceleration were derived at its full rate.
        held_out: runs excluded from fitting; they are averaged but not shortened in any other way.

    Returns:
        The channel with `averaged` set, a sentence, and the original run of each stretch by the stretch's new
        run number. A short channel is returned unchanged, with "" and no stretches.
    """
    if len(data) <= min(LONG, _MAX_BLOCKS * block_length(data)):
        return data, "", {}
    held_runs = np.array(held_out, dtype=np.int64)
    moving, motions, run_of = data, "", dict[int, int]()
    if len(data) > LONG:
        moving, motions, run_of = _from_rest_to_rest(data, held_runs)
    # Samples in the longest block without loss, and the variation within it; None if it was not tested.
    block, seen = block_length(moving), None
    shortest = min(map(len, rows_of_runs(moving.run)))
    while len(moving) > _MAX_BLOCKS * block and 2 * block * _MIN_IN_RUN <= shortest:
        tested = max(2 * block, _MIN_IN_BLOCK)
        variation = _within_blocks(moving, tested)
        if not variation.is_noise(tested):
            break
        block, seen = 2 * block, variation
    short = _means(moving, block)
    rate_hz, unit = 1.0 / sample_time(data.time_s, data.run), data.effort_unit
    note = f"{data.name}: {len(data):,} samples at {rate_hz:.4g} Hz{motions}"
    if block == 1:
        note += " are used as recorded"
    else:
        length = f"{1e3 * block / rate_hz:.3g} ms"
        note += f" are averaged in blocks of {block} to {len(short):,} at {rate_hz / block:.4g} Hz"
        note += (
            f". No information is lost, because a diagnosis uses means over {length} in any case"
            if seen is None
            else (
                f". No information is lost, because within {length} the effort deviates from a straight "
                f"line by {with_unit(seen.departure, unit, 4)}, about as much as the noise between readings "
                f"({with_unit(seen.noise, unit, 4)})"
            )
        )
    for shorten in (_fewer_runs, _fewer_stretches, _average_further):
        if _excess(short, held_runs) > 1:
            short, more, stretches = shorten(short, held_runs)
            note, run_of = note + more, run_of | {new: run_of.get(old, old) for new, old in stretches.items()}
    return short, note, run_of


def _from_rest_to_rest(data: ChannelData, held_runs: IntArray) -> tuple[ChannelData, str, dict[int, int]]:
    """Split a joint's channel that is mostly at rest into motions with some rest before and after."""
    # Range of the position within `_NEAR_S` of each sample.
    extent, width = np.zeros(len(data)), 2 * int(np.ceil(_NEAR_S / sample_time(data.time_s, data.run))) + 1
    for of_run in rows_of_runs(data.run):
        highest = scipy.ndimage.maximum_filter1d(data.position[of_run], width)
        extent[of_run] = highest - scipy.ndimage.minimum_filter1d(data.position[of_run], width)
    is_near = extent > _REST_RANGE * np.ptp(data.position)
    parts = [rows for rows in blocks(2 * data.run + is_near) if is_near[rows.start]]
    parts = [rows for rows in parts if data.run[rows.start] not in held_runs]
    if data.kind is ChannelKind.CONTACT or np.mean(is_near) > _MOVING_SHARE or len(parts) < _MIN_RUNS:
        return data, "", {}
    run, first = data.run.copy(), int(data.run.max()) + 1
    run_of = {first + number: int(data.run[rows.start]) for number, rows in enumerate(parts)}
    for number, rows in enumerate(parts, first):
        run[rows] = number
    moving = replace(data, run=run).of_runs(np.array([*run_of, *held_runs]))
    return moving, f", of which the {len(moving):,} in {len(parts)} motions from rest to rest", run_of


def _within_blocks(data: ChannelData, block: int) -> _BlockVariation:
    """Measure the variation of a channel's effort within blocks of at least four samples."""
    effort = data.effort[_rows(data, block)]
    place = np.arange(block) - 0.5 * (block - 1)
    residual = effort - effort.mean(axis=1, keepdims=True)
    residual -= np.outer(residual @ place / (place @ place), place)
    noise = float(np.mean(np.diff(effort, 3, axis=1) ** 2)) / _THIRD_DIFFERENCE
    return _BlockVariation(
        float(np.sqrt(np.mean(residual**2) * block / (block - 2))), float(np.sqrt(noise)), effort.size
    )


def _rows(data: ChannelData, block: int) -> IntArray:
    """Return the samples of each block, shape (m, block); incomplete blocks at ends of runs are omitted."""
    runs = rows_of_runs(data.run)
    return np.concatenate([rows[: len(rows) // block * block].reshape(-1, block) for rows in runs])


def _means(data: ChannelData, block: int) -> ChannelData:
    if block == 1:
        return data
    rows = _rows(data, block)
    fold, trusted = np.zeros(len(rows), dtype=np.int64), np.ones(len(rows), dtype=np.bool_)
    return decimate(BlockedData(data, rows, data.run[rows[:, 0]], fold, trusted))


def _fewer_runs(data: ChannelData, held_runs: IntArray) -> tuple[ChannelData, str, dict[int, int]]:
    """Select every k-th run, with k such that the selected runs are few enough for the search."""
    runs = np.setdiff1d(data.runs, held_runs)
    stride = min(_excess(data, held_runs), len(runs) // _MIN_RUNS)
    if stride < 2:
        return data, "", {}
    chosen = data.of_runs(np.concatenate([runs[::stride], held_runs]))
    return chosen, _describe_selection(f"{len(runs)} runs", data, chosen, held_runs), {}


def _fewer_stretches(data: ChannelData, held_runs: IntArray) -> tuple[ChannelData, str, dict[int, int]]:
    """Select stretches of a joint's runs that cover a sufficient range of motion, as separate runs."""
    if data.kind is ChannelKind.CONTACT:
        return data, "", {}
    length = _fitted(data, held_runs) // max(_MIN_PIECES, _MIN_RUNS * _excess(data, held_runs))
    length = max(length, _MIN_IN_RUN)
    run, run_of, number = data.run.copy(), dict[int, int](), int(data.run.max())
    for rows in blocks(data.run):  # cut all but held-out runs into stretches of at least this length
        count, old = rows.stop - rows.start, int(data.run[rows.start])
        for part in [] if old in held_runs else np.array_split(np.arange(count), max(count // length, 1)):
            number += 1
            run[rows.start + part], run_of[number] = number, old
    cut = replace(data, run=run)
    min_range = _MIN_COVERED * float(np.ptp(data.position))
    parts = [rows for rows in blocks(cut.run) if cut.run[rows.start] in run_of]
    moving = np.array([cut.run[rows.start] for rows in parts if np.ptp(cut.position[rows]) >= min_range])
    if len(moving) < _MIN_RUNS:
        return data, "", {}
    wide = cut.of_runs(np.concatenate([moving, held_runs]))
    stride = max(1, min(_excess(wide, held_runs), len(moving) // _MIN_RUNS))
    chosen, words = wide.of_runs(np.concatenate([moving[::stride], held_runs])), f"{len(moving)} stretches"
    if len(moving) < len(parts):
        words += f" that cover at least {100 * _MIN_COVERED:.0f} % of the motion ({len(parts)} in all)"
    return chosen, _describe_selection(words, wide, chosen, held_runs), run_of


def _average_further(data: ChannelData, held_runs: IntArray) -> tuple[ChannelData, str, dict[int, int]]:
    """Average over enough samples for a search in acceptable time, although information is lost."""
    factor = _excess(data, held_runs)
    if factor <= _MAX_EXCESS:
        return data, "", {}
    rate_hz = 1.0 / (sample_time(data.time_s, data.run) * factor)
    note = (
        f"; these are too many for a search, so blocks of {factor} are averaged again to {rate_hz:.4g} Hz, "
        "which loses faster changes; to keep faster changes, choose a part of the data with --where"
    )
    return _means(data, factor), note, {}


def _fitted(data: ChannelData, held_runs: IntArray) -> int:
    """Return the number of samples used for fitting."""
    return len(data) - int(np.isin(data.run, held_runs).sum())


def _excess(data: ChannelData, held_runs: IntArray) -> int:
    return -(-_fitted(data, held_runs) // _MAX_SAMPLES)


def _describe_selection(what: str, data: ChannelData, chosen: ChannelData, held_runs: IntArray) -> str:
    before, after = _fitted(data, held_runs), _fitted(chosen, held_runs)
    count = len(np.setdiff1d(chosen.runs, held_runs))
    words = f"; {count} of the {'fitted ' if len(held_runs) else ''}{what} are used"
    wider = f", evenly spread, so intervals are {np.sqrt(before / after):.2g} times as wide"
    return words + (wider if after < before else "")
