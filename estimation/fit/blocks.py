"""Block averages of a channel, and cross-validation folds of whole runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import reading_error
from palpate.estimation.effect import AdditiveEffect, Inner
from palpate.estimation.model import Model, Parameters, own
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import FitCache, IdentityKey
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

# Blocks per second aimed at; slower data is taken as it is. A joint's effort goes with an acceleration
# that was derived twice from an encoder: what of it is noise lies above this rate.
CONTACT_RATE_HZ, JOINT_RATE_HZ = 200.0, 100.0
FOLDS = 6
PIECES, _PIECE_FOLDS = 15, 5  # pieces of a single run, and pieces for each fold
_CORNER = 0.06  # change between readings at a corner, relative to a run's range of velocities
_SLOW_S = 0.011  # step between samples above which corners are not excluded
_CORNER_REACH = 3  # samples to either side of a corner in which a derived velocity is wrong
_MOST_CORNERS = 0.2  # share of blocks; more are not corners but a coarsely sampled motion
_BORDER = 3.0  # standard deviations of the position around a contact boundary
_SETTLING_S = 0.25  # after the first sample, while filters settle
_UNKNOWN_S = 0.1  # at the start of a run, where delays and lags depend on the unknown past
_UNKNOWN = 0.05  # largest share of a run that it takes
_WITHIN = 0.05  # share of the effort's variance that block averages may lose
_SMOOTH = 0.75  # ratio to the step variance of white noise below which variation in a block is smooth
_AGAIN = 0.9  # share of the first touch in a run's contact above which the run hardly presses again
_REST = 0.05  # speed below which a joint rests, relative to its usual highest speed
ALONE = Model("no model", ())
NO_PARAMETERS: Parameters = MappingProxyType({})
LOAD = "load"
LUMPED = "lumped_inertia_effort"  # part of the load that the drive's rotor may carry before the gear
# Effects in which weight acts, and all whose effort is a load;
# not the armature: what accelerates a rotor does not pass through the gear
HEAVY = frozenset({"pendulum", "rigid_body", "rigid_body_fitted", "payload", "gravity_tilt", "weight"})
CARRYING = HEAVY | {"inertia"}
_LUMPED = {"inertia": "m", "pendulum": "inertia"}  # the gain that contains link and rotor


@dataclass(frozen=True)
class BlockedData:
    """Blocks of a channel. Columns are computed at the full rate and then averaged, which biases no model."""

    data: ChannelData  # the channel at its full rate
    rows: IntArray  # shape (m, block), the samples of each of the m blocks
    run: IntArray  # shape (m,), run of each block
    fold: IntArray  # shape (m,), fold in which each block is held out, from 0
    trusted: BoolArray  # shape (m,), whether a block counts
    # What was computed on blocks of this channel, whatever its load and whichever blocks count.
    cache: FitCache = field(default_factory=FitCache)
    load_cache: FitCache = field(default_factory=FitCache)  # what was computed with this load

    def __len__(self) -> int:
        """Number of blocks m."""
        return len(self.rows)

    @property
    def folds(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1

    @property
    def can_hold_out(self) -> bool:
        """Whether at least two folds have blocks that count, so that one can be held out."""
        return len(np.unique(self.fold[self.trusted])) > 1

    def reduce(self, signal: FloatArray) -> FloatArray:
        """Return the means of a signal (n,) or (n, k) over blocks, shape (m,) or (m, k).

        Args:
            signal: a value or k values a sample, shape (n,) or (n, k).
        """
        block = self.rows.shape[1]
        if block == 1:
            return signal[self.rows[:, 0]]
        sums = [self._sums @ column for column in np.atleast_2d(signal.T)]
        return np.asarray(np.reshape(sums, (*signal.shape[1:], len(self))).T / block)

    @property
    def effort(self) -> FloatArray:
        """Measured effort on blocks, shape (m,)."""
        return self.cache.get_or_compute("effort", lambda: self.reduce(self.data.effort))

    def columns(
        self,
        effect: AdditiveEffect,
        inner: Inner,
        beside: Model = ALONE,
        parameters: Parameters = NO_PARAMETERS,
    ) -> FloatArray:
        """Return the columns of an effect on blocks, shape (m, k).

        Args:
            effect: the effect.
            inner: values of the inner parameters by name.
            beside: model whose effects on motion, memory and sensor act on the columns, all of them linear.
            parameters: inner parameters of that model by "effect.parameter".
        """

        def compute(data: ChannelData) -> FloatArray:
            return beside.faded(effect, effect.columns(data, inner), data, parameters)

        return self._cached("columns", effect, inner, beside, parameters, compute)

    def known(
        self,
        effect: AdditiveEffect,
        inner: Inner,
        beside: Model = ALONE,
        parameters: Parameters = NO_PARAMETERS,
    ) -> FloatArray:
        """Return the effort on blocks that an effect adds without any gain, shape (m,).

        Args:
            effect: the effect.
            inner: values of the inner parameters by name.
            beside: model whose effects on motion and sensor act, see `columns`.
            parameters: inner parameters of that model by "effect.parameter".
        """
        return self._cached(
            "known", effect, inner, beside, parameters, lambda data: effect.known(data, inner)
        )

    def _cached(  # noqa: PLR0917
        self,
        what: str,
        effect: AdditiveEffect,
        inner: Inner,
        beside: Model,
        parameters: Parameters,
        compute: Callable[[ChannelData], FloatArray],
    ) -> FloatArray:
        acting = beside.acting
        needs = (*effect.needs, *(name for acts in acting for name in acts.needs))
        cache = self.load_cache if LOAD in needs else self.cache  # it changes with the model
        around = [(IdentityKey(acts), *own(acts, parameters).values()) for acts in acting]

        def on_blocks() -> FloatArray:
            signal = compute(beside.moved(self.data, parameters))
            for sensor in beside.sensors:
                if not sensor.pointwise:
                    signal = sensor.sense(signal, self.data, own(sensor, parameters))
            return self.reduce(signal)

        return cache.get_or_compute((what, IdentityKey(effect), *inner.values(), *around), on_blocks)

    def at_full_rate(self, effect: AdditiveEffect, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the columns of an effect at each sample, shape (n, k); cached for the measured motion.

        Args:
            effect: the effect.
            data: the channel, with the motion that acts.
            inner: values of the inner parameters by name.
        """
        if data is not self.data:
            return effect.columns(data, inner)
        cache = self.load_cache if LOAD in effect.needs else self.cache
        key = ("at full rate", IdentityKey(effect), *inner.values())
        return cache.get_or_compute(key, lambda: effect.columns(data, inner))

    @cached_property
    def _sums(self) -> "scipy.sparse.csr_array":
        """Adds up the samples of each block, (m, n): ten times faster than to pick them and to add."""
        count, block = self.rows.shape
        edges = np.arange(0, count * block + 1, block)
        return scipy.sparse.csr_array(
            (np.ones(count * block), self.rows.ravel(), edges), shape=(count, len(self.data))
        )


def block_length(data: ChannelData) -> int:
    """Return the samples in a block; halved as long as a joint's effort swings within the block.

    Args:
        data: the channel.
    """
    rate_hz = CONTACT_RATE_HZ if data.kind is ChannelKind.CONTACT else JOINT_RATE_HZ
    block = max(1, int(1.0 / (rate_hz * sample_time(data.time_s, data.run)) + 0.5))
    while block > 1 and data.kind is not ChannelKind.CONTACT and _swings_within(data.effort, block):
        block //= 2
    return block


def _swings_within(effort: FloatArray, block: int) -> bool:
    """Check whether averaging over blocks removes a part of an effort (n,) that is not noise."""
    blocks = effort[: len(effort) // block * block].reshape(-1, block)
    within = blocks - blocks.mean(axis=1, keepdims=True)
    if np.mean(within**2) < _WITHIN * np.var(effort):
        return False
    steps = np.diff(blocks, axis=1)  # of white noise, each has twice the variance
    return bool(np.mean(steps**2) < _SMOOTH * 2.0 * np.mean(within**2) * block / (block - 1.0))


def block_average(
    data: ChannelData, good: BoolArray | None = None, cache: FitCache | None = None
) -> BlockedData:
    """Cut a channel into blocks that last 5 or 10 ms, or one sample where that is longer.

    Blocks in which a contact begins or ends are not trusted, nor blocks so near to the surface that the error
    of the position matters: a damper and friction cause a step of the force there. Blocks at sharp corners of
    a contact's motion are not trusted either, nor those in which a probing arm's joint rests or its sensor
    may still settle.

    Args:
        data: the channel.
        good: samples that are fit for use, shape (n,); None for all.
        cache: cache of other blocks of this channel, with any load.
    """
    block = block_length(data)
    rows, folds = [], []
    runs = rows_of_runs(data.run)
    used = len(np.unique(data.run if good is None else data.run[good]))
    pieces, most = (1, FOLDS) if used > 1 else (PIECES, _PIECE_FOLDS)
    for number, of_run in enumerate(runs):
        blocks = of_run[: len(of_run) // block * block].reshape(-1, block)
        piece = np.arange(len(blocks)) * pieces // max(len(blocks), 1)
        rows.append(blocks)
        folds.append((number * pieces + piece) % most)
    grid = np.concatenate(rows)
    fold = np.unique(np.concatenate(folds), return_inverse=True)[1]
    trusted = np.ones(len(grid), dtype=np.bool_) if good is None else good[grid].all(axis=1)
    trusted &= ~(_at_rest(data, grid) | _at_corners(data, grid) | _at_starts(data, grid))
    blocked = BlockedData(data, grid, data.run[grid[:, 0]], fold, trusted, cache or FitCache())
    return exclude_boundaries(blocked, data)


def merge_blocks(blocked: BlockedData, most: int) -> BlockedData:
    """Join neighboring blocks of a run until at most `most` are left, or the effort swings within them.

    Args:
        blocked: the channel on blocks.
        most: number of blocks that are allowed.
    """
    factor = -(-len(blocked) // most)
    while factor > 1 and _swings_within(blocked.effort, factor):
        factor //= 2
    if factor <= 1:
        return blocked
    runs = [of_run[: len(of_run) // factor * factor] for of_run in rows_of_runs(blocked.run)]
    joined = np.concatenate(runs).reshape(-1, factor)
    return replace(
        blocked,
        rows=blocked.rows[joined].reshape(len(joined), -1),
        run=blocked.run[joined[:, 0]],
        fold=blocked.fold[joined[:, 0]],
        trusted=np.asarray(blocked.trusted[joined].all(axis=1)),
        cache=FitCache(),
        load_cache=FitCache(),
    )


def exclude_boundaries(blocked: BlockedData, moved: ChannelData) -> BlockedData:
    """Exclude blocks of a contact within a sample, or the position's error, of its beginning or end.

    Args:
        blocked: the channel on blocks.
        moved: the same channel with the motion that acts on the object.
    """
    if moved.kind is not ChannelKind.CONTACT:
        return blocked
    engaged = moved.engaged[blocked.rows]
    mixed = np.array(engaged.any(axis=1) & ~engaged.all(axis=1))
    borders = engaged[1:, 0] != engaged[:-1, -1]
    mixed[1:] |= borders
    if moved.averaged > 1:  # the surface may lie among the readings that either sample averages
        mixed[:-1] |= borders
    error = reading_error(blocked.data)
    mixed |= np.abs(moved.position[blocked.rows]).min(axis=1) < _BORDER * float(np.std(error))
    return replace(blocked, trusted=blocked.trusted & ~mixed)


def decimate(blocked: BlockedData) -> ChannelData:
    """Average a channel over blocks, one sample for each.

    Args:
        blocked: the channel on blocks.
    """
    data, mean = blocked.data, blocked.reduce
    return replace(
        data,
        time_s=mean(data.time_s),
        position=mean(data.position),
        velocity=mean(data.velocity),
        acceleration=mean(data.acceleration),
        effort=mean(data.effort),
        run=blocked.run,
        phase=data.phase[blocked.rows[:, 0]],
        context={name: mean(signal) for name, signal in data.context.items()},
        position_step=0.0,  # means lie on no grid
        touching=None if data.touching is None else np.asarray(data.touching[blocked.rows].all(axis=1)),
        averaged=data.averaged * blocked.rows.shape[1],
    )


def _at_corners(data: ChannelData, rows: IntArray) -> BoolArray:
    """Blocks of a contact in which the velocity jumps faster than it was sampled, shape (m,).

    A damper causes a jump of the force there, and a derived velocity changes too early and too late. Slow
    data consist of corners, at which creep and relaxation begin: none are excluded.
    """
    if sample_time(data.time_s, data.run) > _SLOW_S:
        return np.zeros(len(rows), dtype=np.bool_)
    sharp = np.zeros(len(data), dtype=np.bool_)
    for of_run in rows_of_runs(data.run) if data.kind is ChannelKind.CONTACT else ():
        velocity = data.velocity[of_run]
        jumps = np.flatnonzero(np.abs(np.diff(velocity)) > _CORNER * data.averaged * np.ptp(velocity))
        around = jumps[:, None] + np.arange(-_CORNER_REACH, _CORNER_REACH + 2)
        sharp[of_run[np.clip(around.ravel(), 0, len(of_run) - 1)]] = True
    corners = np.asarray(sharp[rows].any(axis=1))
    return corners if np.mean(corners) <= _MOST_CORNERS else np.zeros(len(rows), dtype=np.bool_)


def _at_starts(data: ChannelData, rows: IntArray) -> BoolArray:
    """Blocks at the start of a run, shape (m,), where the memory of the object is unknown.

    A run that begins pressed depends on an unknown past until it lets go; if it hardly presses again, it is
    used as if the press began with it.
    """
    starts, engaged = np.zeros(len(data), dtype=np.bool_), data.engaged
    for of_run in rows_of_runs(data.run):
        since_s = data.time_s[of_run] - data.time_s[of_run[0]]
        starts[of_run] = since_s < min(_UNKNOWN_S, _UNKNOWN * float(since_s[-1]))
        if data.kind is ChannelKind.CONTACT:
            pressed = engaged[of_run]
            until = len(pressed) if pressed.all() else int(np.argmin(pressed))
            starts[of_run[:until]] |= until < _AGAIN * np.sum(pressed)
    return np.asarray(starts[rows].any(axis=1))


def _at_rest(data: ChannelData, rows: IntArray) -> BoolArray:
    """Blocks in which a joint of a probing arm is at rest or its sensor still settles, shape (m,).

    Friction at rest depends on how the joint stopped, and the sign of a noisy velocity has no meaning. A slow
    sensor starts from its earlier reading. Other recordings are used as they are.
    """
    if data.kind is ChannelKind.CONTACT or (data.phase < 0).all():
        return np.zeros(len(rows), dtype=np.bool_)
    settling = data.time_s[rows[:, 0]] < data.time_s[0] + _SETTLING_S
    return np.asarray(settling | ~is_moving(data, rows))


def is_moving(data: ChannelData, rows: IntArray) -> BoolArray:
    """Check whether a joint moves during blocks of samples, shape (m,).

    Args:
        data: the channel.
        rows: the samples of each block, shape (m, samples in a block).
    """
    speed = np.abs(data.velocity[rows].mean(axis=1))
    return np.asarray(speed >= _REST * float(np.quantile(np.abs(data.velocity), 0.95)))


def with_load(data: ChannelData, model: Model, parameters: Mapping[str, float]) -> ChannelData:
    """Add the signal `load` to a joint's channel: the effort of the model's inertia and gravity.

    The torque of an inertia that link and rotor may share is a signal of its own beside weights; alone, it
    only scales the load.

    Contacts, channels that have a load already, and models without masses are returned unchanged.

    Args:
        data: the channel.
        model: the model, of which masses and weights count.
        parameters: values by "effect.parameter".
    """
    carrying = Model(model.name, tuple(e for e in model.effects if e.name in CARRYING))
    if data.kind is ChannelKind.CONTACT or LOAD in data.context or not carrying.effects:
        return data
    signals = {LOAD: carrying.predict(data, parameters)}
    names = {effect.name for effect in carrying.effects}
    if names & _LUMPED.keys() and names - {"inertia"}:
        inertia = sum(parameters[f"{name}.{_LUMPED[name]}"] for name in names & _LUMPED.keys())
        signals[LUMPED] = inertia * data.acceleration
    return replace(data, context={**data.context, **signals})
