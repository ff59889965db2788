"""Whether a channel can be diagnosed at all; if not, the reason and the remedy in one sentence."""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.ndimage import median_filter

from estimation.channel import ChannelData, ChannelKind
from estimation.data_quality.motion_and_effort import (
    angle_in_degrees,
    misaligned,
    mistaken_times,
    mistaken_units,
    no_contact,
)
from estimation.data_quality.readings import at_its_end, copied, too_coarse, unchanging
from estimation.data_quality.rectified import rectified
from estimation.fit.colour import ORDER, Colour
from estimation.fit.frame import PIECES, block_length, frame_of
from estimation.model import Model
from estimation.signals.runwise import per_run, sample_time
from robot_io.types import BoolArray

LEAST_SAMPLES = 100
SINGLE_RUN = "a single run"  # how the reason begins where only the division into runs is missing
_MOST_BLOCKS = 300_000  # 25 minutes of blocks of 5 ms: memory grows with them
_GLITCH = 25.0  # times the usual distance between neighbours
_MOST_GLITCHES = 0.01
_SPIKE = 0.2  # of the range of the effort; what stands out by less does no harm
_TRAVELLED = 3.0  # ranges of positions, that a single recording goes through for parts of it to be held out
_QUICKEST_S = 1e-5  # time from sample to sample, below which its unit is in doubt
_DEEP, _RELEASED = 0.5, 0.1  # of the deepest indentation: a press goes from the one to the other


def usable(data: ChannelData) -> BoolArray:
    """Samples that are no glitches of the reader, shape (n,): single readings far off both neighbours."""
    if len(data) == 0:
        return np.ones(0, dtype=np.bool_)
    smooth = per_run(lambda effort: np.asarray(median_filter(effort, 5)), data.effort, data.run)
    off = np.abs(data.effort - smooth)
    usual = float(np.median(off[off > 0.0])) if (off > 0.0).any() else 0.0
    level = max(_GLITCH * usual, _SPIKE * float(np.ptp(smooth)))
    good = np.asarray(off <= level)
    return good if np.mean(~good) <= _MOST_GLITCHES else np.ones(len(data), dtype=np.bool_)


def reject_reason(data: ChannelData, model: Model | None = None) -> str | None:
    """The reason why this channel cannot be diagnosed, and the remedy; None if it can.

    Args:
        data: the channel.
        model: what is to explain it. One with nothing to fit knows what readings at the end of a sensor's
            range should have been, so that these are no reason.
    """
    good = data.select(usable(data))
    return _first((check for _, check in _checks(model)), good) or angle_in_degrees(good, model)


def contaminated(data: ChannelData, model: Model) -> str | None:
    """What is wrong with the readings or the motion, whatever is asked of them; None if nothing shows.

    Unlike `reject_reason`, it asks for nothing to be held out.
    """
    good = data.select(usable(data))
    of_it = (check for kind, check in _CHECKS if kind != "enough" and check is not _blocks)
    return _first(of_it, good) or angle_in_degrees(good, model)


def mention_held_out(reason: str, left: int, recorded: int) -> str:
    """Say in a reason of `reject_reason` how many runs are left of all, where some are held out."""
    few = f"{SINGLE_RUN} is left of {recorded}, the others are held out"
    return reason.replace(SINGLE_RUN, few, 1) if left < recorded else reason


def checklist(data: ChannelData, model: Model | None = None) -> dict[str, str]:
    """What of each kind of check of `reject_reason` speaks against this channel; empty where nothing does.

    Keys: "enough" data, "units" and times, "sync" of effort and motion, "excitation", "readings",
    "saturation". Where one of the first two fails, the others make no sense and are left out.
    """
    good, found = data.select(usable(data)), dict[str, str]()
    for kind in ("enough", "units", "sync", "excitation", "readings", "saturation"):
        if any(found.get(first) for first in ("enough", "units")):
            break
        found[kind] = _first((check for its, check in _checks(model) if its == kind), good) or ""
    if "units" in found and not found["units"]:
        found["units"] = angle_in_degrees(good, model) or ""
    return found


def _length(data: ChannelData) -> str | None:
    if len(data) < LEAST_SAMPLES:
        return f"only {len(data)} samples; record at least {LEAST_SAMPLES}"
    return None


def _size(data: ChannelData) -> str | None:
    """Refuse before anything takes time and memory."""
    lengths = np.unique(data.run, return_counts=True)[1]
    count = int(np.sum(lengths // block_length(data)))
    if count > _MOST_BLOCKS:
        more = f"{count} blocks are more than can be searched, {_MOST_BLOCKS}"
        several = len(lengths) > 1
        some = (
            f"some of the {len(lengths)} runs with --where run=N,N ..." if several else "shorter recordings"
        )
        return f"{more}; take {some}"
    return None


def _runs(data: ChannelData) -> str | None:
    """One run must cover its motion several times over, so that parts of it can be held out."""
    if len(data.runs) > 1:
        touching = np.unique(data.run[data.engaged]) if data.kind is ChannelKind.CONTACT else data.runs
        if len(touching) == 1:
            return f"{SINGLE_RUN} of {len(data.runs)} touches; record at least three that do"
        return None
    if data.kind is ChannelKind.CONTACT:
        presses = _presses(data)
        if presses > 1:
            return f"{SINGLE_RUN} with {presses} presses; number them in a column `run` of the data file"
        return f"{SINGLE_RUN}, so there is no other to judge by; record at least three runs"
    travelled = sum(np.ptp(part) for part in np.array_split(data.position, PIECES))
    if travelled < _TRAVELLED * np.ptp(data.position):
        return f"{SINGLE_RUN} that goes through its motion once; record at least three runs"
    return None


def _presses(data: ChannelData) -> int:
    """How often the object was pressed to half of the deepest indentation, after it was let go."""
    deepest = float(data.position.max())
    sides = np.where(data.position > _DEEP * deepest, 1, np.where(data.position < _RELEASED * deepest, -1, 0))
    met = sides[sides != 0]
    return int(np.count_nonzero((met[1:] > 0) & (met[:-1] < 0)) + (len(met) > 0 and met[0] > 0))


def _blocks(data: ChannelData) -> str | None:
    """There must be a block to fit to, and one to hold out, in another run if there are several.

    So many in a row as the noise's colour needs, too: a run that is shorter says nothing of its noise.
    """
    least, lengths = block_length(data), np.unique(data.run, return_counts=True)[1]
    parts = lengths // least if len(lengths) == 1 else lengths >= least
    if parts.sum() < 2:
        step_s = sample_time(data.time_s, data.run)
        unit = (
            f", or check the unit of time: samples are {step_s:.2g} s apart" if step_s < _QUICKEST_S else ""
        )
        return f"fewer than two runs have {least} samples or more; record longer runs{unit}"
    frame = frame_of(data)
    if len(np.unique(frame.fold[frame.trusted])) < 2:
        return "in one run at most something moves, so nothing can be held out to judge by; record more runs"
    if len(np.unique(frame.fold[Colour(np.zeros(ORDER)).kept(frame.run, frame.trusted)])) < 2:
        return f"fewer than two runs go on for {(ORDER + 1) * least} samples or more; record longer runs"
    return None


_Check = Callable[[ChannelData], str | None]
_CHECKS: tuple[tuple[str, _Check], ...] = (  # by kind; in the order in which `reject_reason` asks
    ("enough", _length),
    ("enough", _size),
    ("excitation", unchanging),
    ("enough", _runs),
    ("enough", copied),
    ("units", mistaken_units),
    ("units", mistaken_times),
    ("sync", misaligned),
    ("excitation", no_contact),
    ("readings", too_coarse),
    ("readings", rectified),
    ("excitation", _blocks),
    ("saturation", at_its_end),
)


def _checks(model: Model | None) -> tuple[tuple[str, _Check], ...]:
    """Those that concern a channel which this model is to explain."""
    known = model is not None and not model.gains and not model.inner
    return tuple(one for one in _CHECKS if not (known and one[0] == "saturation"))


def _first(checks: Iterable[_Check], data: ChannelData) -> str | None:
    return next(filter(None, (check(data) for check in checks)), None)
