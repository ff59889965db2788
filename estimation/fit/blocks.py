"""Block averages of a channel, and cross-validation folds of whole runs."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import reading_error
from palpate.estimation.effect import AdditiveEffect, Effect, MotionEffect, Parameters, SensorEffect
from palpate.estimation.model import Model, own_parameters
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import FitCache, IdentityKey
from palpate.estimation.signals.motion import is_stepwise_command
from palpate.estimation.signals.runwise import longest_run, sample_time
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

# Target number of blocks per second, and least number in the longest run. Slower data are not averaged.
# The acceleration of a joint is derived twice from an encoder, and its noise lies mostly above this rate.
CONTACT_RATE_HZ, JOINT_RATE_HZ = 200.0, 100.0
_MIN_BLOCKS = 200
FOLDS = 6
PIECES, _PIECE_FOLDS = 15, 5  # pieces of a single run, and pieces for each fold
_CORNER = 0.06  # change between readings at a corner, relative to a run's range of velocities
_SLOW_S = 0.011  # step between samples above which corners are not excluded
_CORNER_REACH = 3  # samples on each side of a corner in which a derived velocity is wrong
_MAX_EXCLUDED = 0.2  # largest share of blocks at corners or stops; more indicate a coarse measurement
_LONG_STOP = 5.0  # least length of a stop, relative to the step of the position before or after it
_MIN_READINGS = 2  # equal readings in a step of the position; with fewer, the sampling limits its resolution
_FIRST_STEP = 4.0  # longest time of the first step after a stop, relative to that of the second one
_BORDER = 3.0  # excluded distance from a contact boundary, in standard deviations of the position's error
_SETTLING_S = 0.25  # time after the first sample in which filters settle
_UNKNOWN_S = 0.1  # time at the start of a run in which delays and lags depend on the unknown past
_UNKNOWN = 0.05  # largest share of a run that is excluded for this reason
_MAX_LOST = 0.05  # share of the effort's variance that block averages may lose
_SMOOTH = 0.75  # ratio to the step variance of white noise below which variation in a block is smooth
_FIRST_SHARE = 0.9  # share of the first contact in a run's contact above which later contacts are negligible
_REST = 0.05  # largest speed of a joint at rest, relative to its usual highest speed
LOAD = "load"
LUMPED = "lumped_inertia_effort"  # part of the load that may act on the drive's rotor before the gear
# Effects with weight, and all effects whose effort is a load. A spring's force passes through the gear, too.
# The armature is not among them, because the torque that accelerates a rotor does not.
HEAVY = frozenset({"pendulum", "rigid_body", "rigid_body_fitted", "payload", "gravity_tilt", "weight"})
CARRYING = HEAVY | {"inertia", "joint_spring"}
LUMPED_GAINS = {"inertia": "m", "pendulum": "inertia"}  # gains that contain the inertias of link and rotor


@dataclass(frozen=True)
class BlockedData:
    """Block averages of a channel; columns are averaged after computation, which causes no bias."""

    data: ChannelData  # the channel at its full rate
    rows: IntArray  # samples of each of the m blocks, shape (m, block)
    run: IntArray  # run number of each block, shape (m,)
    fold: IntArray  # fold in which each block is held out, from 0, shape (m,)
    trusted: BoolArray  # whether a block is used, shape (m,)
    # Results on blocks of this channel. Keys contain the load, and results do not depend on `trusted`, so all
    # fits share one cache.
    cache: FitCache = field(default_factory=FitCache)

    def __post_init__(self) -> None:
        """Keep a read-only view of the run numbers, because only results of read-only arrays are cached."""
        run = self.run.view()
        run.setflags(write=False)
        object.__setattr__(self, "run", run)

    def __len__(self) -> int:
        """Number of blocks m."""
        return len(self.rows)

    @property
    def folds(self) -> int:
        """Number of folds."""
        return int(self.fold.max()) + 1

    @property
    def can_hold_out(self) -> bool:
        """Whether at least two folds have trusted blocks, so that one can be held out."""
        return len(np.unique(self.fold[self.trusted])) > 1

    def reduce(self, signal: FloatArray) -> FloatArray:
        """Return the means of a signal (n,) or (n, k) over blocks, shape (m,) or (m, k).

        Args:
            signal: one or k values per sample, shape (n,) or (n, k).
        """
        block = self.rows.shape[1]
        if self._are_samples:
            return signal
        if block == 1:
            return signal.T.take(self.rows[:, 0], axis=-1).T
        sums = [self._sums @ column for column in np.atleast_2d(signal.T)]
        return np.asarray(np.reshape(sums, (*signal.shape[1:], len(self))).T / block)

    @property
    def time_s(self) -> FloatArray:
        """Mean time of each block, shape (m,) [s]."""
        return self.cache.get_or_compute("time", lambda: self.reduce(self.data.time_s))

    @property
    def effort(self) -> FloatArray:
        """Measured effort on blocks, shape (m,)."""
        return self.cache.get_or_compute("effort", lambda: self.reduce(self.data.effort))

    def parts(self, effect: AdditiveEffect, model: Model, parameters: Parameters) -> FloatArray:
        """Return the effort per unit of each gain of an effect, and that without gains, (m, k + 1); cached.

        Args:
            effect: the effect, with k gains.
            model: the model; its effects on motion, memory and sensor act here, and all must be linear.
            parameters: inner parameters of the model by "effect.parameter".
        """
        acting, inner = model.coupled_effects, own_parameters(effect, parameters)
        load = self._load_of(effect, *acting)
        acting_key = [(IdentityKey(acts), *own_parameters(acts, parameters).values()) for acts in acting]

        def compute() -> FloatArray:
            moved = model.moved(self.data, parameters)
            signal = model.relaxed_columns(effect, effect.columns(moved, inner), moved, parameters)
            has_known = type(effect).known is not AdditiveEffect.known
            if has_known:
                signal = np.column_stack([signal, effect.known(moved, inner)])
            for sensor in model.sensors:
                if not sensor.pointwise:
                    signal = sensor.sense(signal, self.data, own_parameters(sensor, parameters))
            parts = self.reduce(signal)
            return parts if has_known else np.column_stack([parts, np.zeros(len(self))])

        key = IdentityKey(effect), IdentityKey(load), *inner.values(), *acting_key
        return self.cache.get_or_compute(key, compute, load)

    def initial_response(self, model: Model, parameters: Parameters) -> FloatArray:
        """Return the means (m,) of `SensorEffect.initial_response` after all sensors of a model; cached.

        Args:
            model: the model, whose sensor effects must be linear.
            parameters: inner parameters of the model by "effect.parameter".
        """
        inner = [own_parameters(sensor, parameters) for sensor in model.sensors]

        def compute() -> FloatArray:
            total, none = np.zeros(len(self.data)), np.empty((len(self.data), 0))
            for sensor, own in zip(model.sensors, inner, strict=True):
                total = sensor.follow(total, none, self.data, own)[1]
            return self.reduce(total)

        if all(type(sensor).initial_response is SensorEffect.initial_response for sensor in model.sensors):
            return np.zeros(len(self))
        acting = ((IdentityKey(s), *own.values()) for s, own in zip(model.sensors, inner, strict=True))
        return self.cache.get_or_compute(("initial", *acting), compute)

    def _load_of(self, *effects: Effect) -> FloatArray | None:
        """Return the load (n,), which depends on the model; None if no effect needs it."""
        return self.data.context[LOAD] if any(LOAD in effect.needs for effect in effects) else None

    def at_full_rate(
        self, model: Model, effect: AdditiveEffect, data: ChannelData, parameters: Parameters
    ) -> FloatArray:
        """Return `Model.columns` at each sample, shape (n, k); cached.

        Args:
            model: the model.
            effect: an effect of the model.
            data: the channel, with the motion that acts on the object.
            parameters: a value for every inner parameter.
        """
        if data is not model.moved(self.data, parameters):  # simulated
            return model.columns(effect, data, parameters)
        inner = own_parameters(effect, parameters)
        moves = [each for each in model.effects if isinstance(each, MotionEffect)]
        load = self._load_of(effect, *moves)
        key: tuple[Hashable, ...] = "at full rate", IdentityKey(effect), IdentityKey(load), *inner.values()
        key += tuple((IdentityKey(each), *own_parameters(each, parameters).values()) for each in moves)
        columns = self.cache.get_or_compute(key, lambda: effect.columns(data, inner), load)
        if not (memories := model.memories_of(effect)):
            return columns
        key += tuple((IdentityKey(each), *own_parameters(each, parameters).values()) for each in memories)
        return self.cache.get_or_compute(
            key, lambda: model.relaxed_columns(effect, columns, data, parameters), load
        )

    @cached_property
    def _are_samples(self) -> bool:
        """Whether the blocks are the samples themselves, in the same order."""
        return self.rows.shape == (len(self.data), 1) and np.array_equal(
            self.rows[:, 0], np.arange(len(self.data))
        )

    @cached_property
    def _sums(self) -> "scipy.sparse.csr_array":
        """Matrix (m, n) that sums the samples of each block, ten times faster than indexing."""
        count, block = self.rows.shape
        edges = np.arange(0, count * block + 1, block)
        return scipy.sparse.csr_array(
            (np.ones(count * block), self.rows.ravel(), edges), shape=(count, len(self.data))
        )


def block_length(data: ChannelData) -> int:
    """Return the number of samples in a block, halved as long as the effort varies within it.

    A block lasts about 5 ms in a contact and 10 ms in a joint, less in short runs, but at least one sample.

    Args:
        data: the channel; only the effort in contact can shorten the blocks of a contact.
    """
    rate_hz = CONTACT_RATE_HZ if data.kind is ChannelKind.CONTACT else JOINT_RATE_HZ
    rate_hz = max(rate_hz, _MIN_BLOCKS / longest_run(data.time_s, data.run))
    block = max(1, int(1.0 / (rate_hz * sample_time(data.time_s, data.run)) + 0.5))
    effort = data.effort[data.engaged] if data.kind is ChannelKind.CONTACT else data.effort
    while block > 1 and len(effort) and (len(effort) < block or _varies_within(effort, block)):
        block //= 2
    return block


def _varies_within(effort: FloatArray, block: int) -> bool:
    """Return whether averaging over blocks removes a part of an effort (n,) that is not noise."""
    blocks = effort[: len(effort) // block * block].reshape(-1, block)
    within = blocks - blocks.mean(axis=1, keepdims=True)
    if np.mean(within**2) < _MAX_LOST * np.var(effort):
        return False
    steps = np.diff(blocks, axis=1)  # for white noise their variance is twice that of the noise
    return bool(np.mean(steps**2) < _SMOOTH * 2.0 * np.mean(within**2) * block / (block - 1.0))


def block_average(
    data: ChannelData, good: BoolArray | None = None, cache: FitCache | None = None
) -> BlockedData:
    """Divide a channel into blocks of 5 ms (contact) or 10 ms (joint), but at least of one sample.

    They are shorter in short runs and where the effort varies.

    Blocks at contact boundaries are not trusted: there damping and friction cause a step of the force, which
    the error of the position can shift. Blocks at sharp corners of a contact's motion, and blocks in which a
    motion stops or begins within one step of a coarse position, are not trusted either.
    For a probing arm, blocks in which a joint is at rest or its sensor may still settle are not trusted.

    Args:
        data: the channel.
        good: samples that a fit may use, shape (n,); None for all.
        cache: cache of other blocks of this channel, with any load.
    """
    block = block_length(data)
    rows, folds = [], []
    runs = rows_of_runs(data.run)
    used = len(np.unique(data.run if good is None else data.run[good]))
    pieces, fold_count = (1, FOLDS) if used > 1 else (PIECES, _PIECE_FOLDS)
    for number, run_rows in enumerate(runs):
        blocks = run_rows[: len(run_rows) // block * block].reshape(-1, block)
        piece = np.arange(len(blocks)) * pieces // max(len(blocks), 1)
        rows.append(blocks)
        folds.append((number * pieces + piece) % fold_count)
    grid = np.concatenate(rows)
    fold = np.unique(np.concatenate(folds), return_inverse=True)[1]
    trusted = np.ones(len(grid), dtype=np.bool_) if good is None else good[grid].all(axis=1)
    cache = cache or FitCache()
    rules = (_at_rest, _at_corners, _at_starts, _at_stops)
    trusted &= ~cache.get_or_compute(
        "excluded", lambda: np.logical_or.reduce([rule(data, grid) for rule in rules])
    )
    blocked = BlockedData(data, grid, data.run[grid[:, 0]], fold, trusted, cache)
    return exclude_boundaries(blocked, data)


def merge_blocks(blocked: BlockedData, most: int) -> BlockedData:
    """Join neighboring blocks of a run to obtain at most `most`, unless the effort varies within them.

    Args:
        blocked: the channel on blocks.
        most: largest number of blocks.
    """
    factor = -(-len(blocked) // most)
    while factor > 1 and _varies_within(blocked.effort, factor):
        factor //= 2
    if factor <= 1:
        return blocked
    runs = [run_rows[: len(run_rows) // factor * factor] for run_rows in rows_of_runs(blocked.run)]
    joined = np.concatenate(runs).reshape(-1, factor)
    return replace(
        blocked,
        rows=blocked.rows[joined].reshape(len(joined), -1),
        run=blocked.run[joined[:, 0]],
        fold=blocked.fold[joined[:, 0]],
        trusted=np.asarray(blocked.trusted[joined].all(axis=1)),
        cache=FitCache(),
    )


def exclude_boundaries(
    blocked: BlockedData, moved: ChannelData, recovering: BoolArray | None = None
) -> BlockedData:
    """Exclude blocks of a contact at its boundaries, within one sample or the error of the position.

    Args:
        blocked: the channel on blocks.
        moved: the same channel with the motion that acts on the object.
        recovering: samples in which the tip has not yet reached a surface that recovers, shape (n,).
    """
    if moved.kind is not ChannelKind.CONTACT:
        return blocked
    engaged = moved.engaged[blocked.rows]
    mixed = np.array(engaged.any(axis=1) & ~engaged.all(axis=1))
    borders = engaged[1:, 0] != engaged[:-1, -1]
    mixed[1:] |= borders
    if moved.averaged > 1:  # the boundary may lie within the readings averaged in either sample
        mixed[:-1] |= borders
    error = reading_error(blocked.data)
    mixed |= np.abs(moved.position[blocked.rows]).min(axis=1) < _BORDER * float(np.std(error))
    if recovering is not None:
        touches = np.flatnonzero(recovering[:-1] & ~recovering[1:])
        beside = np.zeros(len(moved), dtype=np.bool_)
        beside[touches] = beside[touches + 1] = True
        mixed |= beside[blocked.rows].any(axis=1)
    return replace(blocked, trusted=blocked.trusted & ~mixed)


def decimate(blocked: BlockedData) -> ChannelData:
    """Return the channel averaged over blocks, with one sample per block.

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
        position_step=0.0,  # means are not quantized
        touching=None if data.touching is None else np.asarray(data.touching[blocked.rows].all(axis=1)),
        averaged=data.averaged * blocked.rows.shape[1],
        is_command=is_stepwise_command(data),
    )


def _at_corners(data: ChannelData, rows: IntArray) -> BoolArray:
    """Return the mask (m,) of contact blocks in which the velocity changes faster than it was sampled."""
    # A damper causes a jump of the force there, which a derived velocity smears over several samples.
    if sample_time(data.time_s, data.run) > _SLOW_S:
        return np.zeros(len(rows), dtype=np.bool_)
    sharp = np.zeros(len(data), dtype=np.bool_)
    for run_rows in rows_of_runs(data.run) if data.kind is ChannelKind.CONTACT else ():
        velocity = data.velocity[run_rows]
        jumps = np.flatnonzero(np.abs(np.diff(velocity)) > _CORNER * data.averaged * np.ptp(velocity))
        near_rows = jumps[:, None] + np.arange(-_CORNER_REACH, _CORNER_REACH + 2)
        sharp[run_rows[np.clip(near_rows.ravel(), 0, len(run_rows) - 1)]] = True
    corners = np.asarray(sharp[rows].any(axis=1))
    return corners if np.mean(corners) <= _MAX_EXCLUDED else np.zeros(len(rows), dtype=np.bool_)


def _at_starts(data: ChannelData, rows: IntArray) -> BoolArray:
    """Return the mask (m,) of blocks at the start of a run, where the object's past is unknown."""
    # If contacts after one at the start are negligible, the run is used as if the contact began with it.
    starts, engaged = np.zeros(len(data), dtype=np.bool_), data.engaged
    for run_rows in rows_of_runs(data.run):
        elapsed_s = data.time_s[run_rows] - data.time_s[run_rows[0]]
        starts[run_rows] = elapsed_s < min(_UNKNOWN_S, _UNKNOWN * float(elapsed_s[-1]))
        if data.kind is ChannelKind.CONTACT:
            pressed = engaged[run_rows]
            until = len(pressed) if pressed.all() else int(np.argmin(pressed))
            starts[run_rows[:until]] |= until < _FIRST_SHARE * np.sum(pressed)
    return np.asarray(starts[rows].any(axis=1))


def _at_stops(data: ChannelData, rows: IntArray) -> BoolArray:
    """Return the mask (m,) of blocks in which the motion stops or begins within a step of the position."""
    # Friction reverses there before the position shows a motion. With constant jerk, the first step takes at
    # most 3.8 times as long as the second one. For steps of one reading, the sampling limits the resolution.
    hidden = np.zeros(len(data), dtype=np.bool_)
    for run_rows in rows_of_runs(data.run):
        position = data.position[run_rows]
        changes = np.concatenate([[0], np.flatnonzero(np.diff(position)) + 1, [len(position)]])
        lengths = np.diff(changes)
        for stop in np.flatnonzero(lengths >= _LONG_STOP * _MIN_READINGS):
            first, last = changes[stop], changes[stop + 1]
            for step, is_before in ((stop - 1, True), (stop + 1, False)):
                at_end = not 0 < step < len(lengths) - 1
                if at_end or not _MIN_READINGS <= lengths[step] <= lengths[stop] / _LONG_STOP:
                    continue
                reach = int(_FIRST_STEP * lengths[step])
                low, high = (changes[step], first + reach) if is_before else (last - reach, changes[step + 1])
                hidden[run_rows[low:high]] = True
    stops = np.asarray(hidden[rows].any(axis=1))
    return stops if np.mean(stops) <= _MAX_EXCLUDED else np.zeros(len(rows), dtype=np.bool_)


def _at_rest(data: ChannelData, rows: IntArray) -> BoolArray:
    """Return the mask (m,) of blocks in which a probing arm's joint is at rest or its sensor settles."""
    # Friction at rest depends on how the joint stopped, and a slow sensor starts from its earlier reading.
    if data.kind is ChannelKind.CONTACT or (data.phase < 0).all():
        return np.zeros(len(rows), dtype=np.bool_)
    settling = data.time_s[rows[:, 0]] < data.time_s[0] + _SETTLING_S
    return np.asarray(settling | ~is_moving(data, rows))


def is_moving(data: ChannelData, rows: IntArray) -> BoolArray:
    """Return the mask (m,) of blocks in which a joint moves.

    Args:
        data: the channel.
        rows: samples of each block, shape (m, samples in a block).
    """
    speed = np.abs(data.velocity[rows].mean(axis=1))
    return np.asarray(speed >= _REST * float(np.quantile(np.abs(data.velocity), 0.95)))


def with_load(data: ChannelData, model: Model, parameters: Mapping[str, float]) -> ChannelData:
    """Add the signal `load` to a joint's channel: the effort of the model's inertia, gravity and spring.

    If the model has weight or a spring, the torque of an inertia that link and rotor may share is a separate
    signal. Contacts, channels with a load, and models without masses are returned unchanged.

    Args:
        data: the channel.
        model: the model, whose masses and weights are used.
        parameters: values by "effect.parameter".
    """
    carrying = Model(model.name, tuple(e for e in model.effects if e.name in CARRYING))
    if data.kind is ChannelKind.CONTACT or LOAD in data.context or not carrying.effects:
        return data
    signals = {LOAD: carrying.predict(data, parameters)}
    names = {effect.name for effect in carrying.effects}
    if names & LUMPED_GAINS.keys() and names - {"inertia"}:
        inertia = sum(parameters[f"{name}.{LUMPED_GAINS[name]}"] for name in names & LUMPED_GAINS.keys())
        signals[LUMPED] = inertia * data.acceleration
    return replace(data, context={**data.context, **signals})
