"""Narrow flexible laws, one for each kind of effect.

A law is additive, is a single-valued function of the kind's signals, and has few parameters. Wider laws would
replace each other, so that no kind would seem necessary. `FlexibleLaw.nonnegative` marks columns whose sign
is fixed by physics: friction, relaxation and inertia oppose the motion.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.flexible_regression import hats, reversal_memory
from palpate.estimation.kinds import UNSEEN_IN_ONE_PASS, Kind
from palpate.estimation.signals.blocks import has_one_clock, rows_of_runs
from palpate.estimation.signals.contact_memory import pressed_samples, remaining_strain
from palpate.estimation.signals.exponential_memory import low_pass, relax
from palpate.estimation.signals.free_air import may_have_dead_band, zero_in_free_air
from palpate.estimation.signals.motion import (
    has_constant_speed,
    is_monotonic,
    is_one_pass,
    is_stepwise_command,
    never_returns,
)
from palpate.estimation.signals.runwise import derivative, longest_run, running_max, sample_time, shift
from palpate.estimation.statistics.correlation import noise_between_samples
from palpate.estimation.statistics.least_squares import solve_within_bounds
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_REVERSAL_PATHS = (0.001, 0.003, 0.01, 0.04, 0.15, 0.5)  # lengths of reversal memory, relative to range
_DIRECTION_WIDTHS = (0.004, 0.02)  # widths of the change of direction, relative to the rms speed
_KNOTS = (0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)  # hinges: shares of the range, and quantiles
_TIMES_PER_DECADE = 4  # relaxation times, from a few samples to twice the longest run
_MIN_TIME = 0.03  # shortest relaxation time, relative to the time scale of the motion
# Time constants and delays of sensors, relative to the longest one. The longest one is a multiple of the time
# scale of the motion, and at most 0.3 s: slower sensors hardly serve to measure an effort.
_LAGS = (0.03, 0.1, 0.3, 1.0)
_LONGEST_LAG, _LONGEST_LAG_S = 3.0, 0.3
_BISECTIONS = 4  # number of times the intervals next to the best of them are halved
_ADHESION_RANGES = (0.02, 0.06, 0.2)  # ranges of adhesion, relative to the deepest indentation
_SURFACE_HEIGHTS = (0.03, 0.1, 0.3)  # heights of the surface, relative to the deepest indentation
_PLASTIC_SETS = (0.1, 0.3, 0.6, 0.9)  # plastic sets, relative to the deepest indentation so far
_SPANNED = 1e-6  # share of a signal's energy outside the columns' span up to which they contain the signal
_FULL_SCALE = 0.95  # share of the largest reading above which a sensor may saturate
_DEAD_BANDS = (0.01, 0.03, 0.1)  # half widths of dead bands, as shares of the effort's range
_MIN_BIAS_SHARE = 0.02  # least share of the squared error that the bias in free air must explain
_MAX_RUNS = 30  # largest number of runs that may each have their own waves
_MAX_WAVES = 10  # largest number of waves of the periodic law
_MIN_WAVE_SHARE = 0.02  # least share of the residual energy that one more wave must explain
_BINS = 8192  # position bins for the spectrum
_WHOLE_TURN = 0.75  # range in turns above which wave numbers are whole numbers per turn
_MIN_WAVES = 3  # least number of waves within a narrower range; fewer resemble any smooth law
# Forces of the object, which can only push. Friction may act on the sides of the tool, and adhesion pulls.
OBJECT_KINDS = frozenset({Kind.ELASTIC_SHAPE, Kind.RATE_DEPENDENCE, Kind.TIME_MEMORY, Kind.CONTACT_GEOMETRY})
# Kinds that depend on the position, the time or the past motion.
_MOTION_KINDS = {Kind.ELASTIC_SHAPE, Kind.TIME_MEMORY, Kind.PERIODIC, Kind.GRAVITY_LOAD, Kind.DRIFT}
COLLINEAR = 1e-9  # ridge penalty of the base model's columns, too small to shrink them
GRAVITY_RANGE = 0.3  # [rad]; over a narrower range gravity resembles a constant and a spring

Sense = Callable[[FloatArray], FloatArray]  # from the true effort, or columns of it, to the readings


@dataclass(frozen=True)
class FlexibleLaw:
    """Columns of one kind, or of the interaction of two, on m blocks."""

    kinds: frozenset[Kind]  # the columns are used if a model has all of these kinds
    columns: FloatArray  # shape (m, k)
    nonnegative: BoolArray  # shape (k,), whether physics fixes the sign of a column's coefficient
    one_sided: bool = True  # whether it is part of the object's force, which only pushes


@dataclass(frozen=True)
class BaseColumns:
    """Columns of the base model, which are part of every regression."""

    columns: FloatArray  # shape (m, q)
    gains: FloatArray  # their fitted coefficients, shape (q,)
    lower: FloatArray  # lower bounds of the coefficients, shape (q,)
    one_sided: BoolArray  # whether a column is part of the object's force, which only pushes, (q,)


def flexible_laws(
    blocked: BlockedData,
    base: BaseColumns | None,
    effort: FloatArray,
    residual: FloatArray,
    used: BoolArray,
    *,
    slope: FloatArray,
    has_weight: bool,
) -> list[FlexibleLaw]:
    """Build the laws of all kinds that can occur in a channel, and of the interactions between kinds.

    Differences between runs have no columns, see `palpate.estimation.budget.held_out`.

    Args:
        blocked: the channel on its blocks.
        base: columns of the model, refitted for the sensor's dynamics; None to keep the fit.
        effort: prediction of the model on blocks, shape (m,) [N or N m].
        residual: residual of the model on blocks, shape (m,); it selects the waves of the periodic law.
        used: blocks that the model is fitted to, shape (m,).
        slope: derivative of the prediction with respect to the position, shape (m,) [effort/position].
        has_weight: whether the load of the joint contains a weight; otherwise a law of the load would be a
            law of the acceleration.
    """
    data, run = blocked.data, blocked.run
    is_contact = data.kind is ChannelKind.CONTACT
    position, time_s = blocked.reduce(data.position), blocked.time_s
    touching = blocked.reduce(data.engaged.astype(np.float64))
    velocity, acceleration = (blocked.reduce(s * data.engaged) for s in (data.velocity, data.acceleration))
    depth = blocked.reduce(data.position * data.engaged) if is_contact else position
    unit_depth, unit_speed = _unit(depth), _unit(velocity)

    zero, error = zero_in_free_air(data), np.mean(residual[used] ** 2)
    has_bias = zero is None or not (zero.is_zero or zero.bias**2 < _MIN_BIAS_SHARE * error)
    relaxed = _relaxation(blocked, touching, _MIN_TIME * data.time_scale)
    # forces that oppose the motion and grow with speed: linearly, faster and slower
    fast = np.abs(unit_speed)
    dissipation = (unit_speed, unit_speed * fast, unit_speed**3, unit_speed / (1.0 + fast))
    laws = [
        _law(Kind.ELASTIC_SHAPE, _hinges(depth), unit_depth * np.abs(unit_depth), unit_depth**3),
        _law(Kind.RATE_DEPENDENCE, *dissipation, nonnegative=True),
        _law(Kind.FRICTION, *_friction(blocked, unit_speed, depth, slope, touching), nonnegative=True),
        _law(Kind.TIME_MEMORY, *relaxed(depth), nonnegative=True),
        _law((Kind.ELASTIC_SHAPE, Kind.TIME_MEMORY), *relaxed(depth * unit_depth), nonnegative=True),
        _law(Kind.INERTIA, acceleration, nonnegative=True),
        *_sensor_dynamics(blocked, base, effort, time_s, used),
        _sensor_statics(effort, blocked.effort, run, base, touching > 0.0, has_bias=has_bias),
    ]
    if (zero is None or not zero.is_steady) and not is_monotonic(position, run):
        elapsed_s = time_s - time_s.min()  # times may count from 1970
        rate, offset = np.polyfit(elapsed_s[used], residual[used], 1)
        # A drift is zero at one time of the session; a further constant is a bias.
        origin_s = np.clip(-offset / rate, 0.0, elapsed_s.max()) if rate else 0.0
        laws.append(_law(Kind.DRIFT, elapsed_s - origin_s))
    if is_contact:
        laws += _contact_geometry(position, depth, touching, run)
        products = (unit_speed * unit_depth, unit_speed * unit_depth**2)
        laws.append(_law((Kind.ELASTIC_SHAPE, Kind.RATE_DEPENDENCE), *products))
    else:
        is_angle = data.kind.is_angle
        laws.append(_law(Kind.PERIODIC, periodic_columns(position, residual, is_angle=is_angle)))
        if 1 < len(np.unique(run)) <= _MAX_RUNS:
            run_columns = periodic_columns(position, residual, is_angle=is_angle, run=run)
            laws.append(_law((Kind.PERIODIC, Kind.RUN_DIFFERENCES), run_columns))
        load = [hats(blocked.reduce(data.context["load"]))] if has_weight else []
        if is_angle and np.ptp(position) > GRAVITY_RANGE:
            load += [np.sin(position), np.cos(position)]
        laws.append(_law(Kind.GRAVITY_LOAD, *load))
    recorded = [blocked.reduce(data.context[name]) for name in sorted(data.recorded)]
    scaled = [_unit(column - column.mean()) for column in recorded]
    laws.append(_law(Kind.RECORDED_CONTEXT, *map(hats, recorded), *(unit * effort for unit in scaled)))
    direction = np.tanh(unit_speed / _DIRECTION_WIDTHS[-1])
    laws.append(_law((Kind.FRICTION, Kind.RECORDED_CONTEXT), *(unit * direction for unit in scaled)))
    pushing, unseen = OBJECT_KINDS if is_contact else frozenset[Kind](), unseen_kinds(data)
    return [
        replace(law, one_sided=law.one_sided and law.kinds <= pushing)
        for law in laws
        if law.columns.size and not law.kinds & unseen
    ]


def unseen_kinds(data: ChannelData) -> frozenset[Kind]:
    """Find the kinds that a channel cannot show.

    Without recorded times, a delay or an inertia has no meaning, and steady states show only laws of the
    velocity, of a sensor's readings and of recorded signals.
    A joint whose effort is a stepwise command has no effort sensor, so sensor statics are excluded. In a
    contact, the motion may make a kind look like a law of the position.

    Path memory needs a run that returns. Any memory, and a sensor's characteristic curve without a bias in
    free air, need several passes or speeds. Rate dependence needs more than one speed, else it looks like
    friction or the base model's damping. A drift needs several runs on one clock, or free air at both ends of
    a run: within one contact, slow relaxation changes the effort in the same way.

    Args:
        data: the channel.
    """
    unseen = set[Kind]() if data.has_time else {Kind.SENSOR_DYNAMICS, Kind.INERTIA}
    if data.is_steady:
        unseen |= _MOTION_KINDS
    if data.kind is not ChannelKind.CONTACT:
        return frozenset(unseen | ({Kind.SENSOR_STATICS} if is_stepwise_command(data) else set()))
    zero = zero_in_free_air(data)
    unseen |= {Kind.RATE_DEPENDENCE} if has_constant_speed(data.velocity[data.engaged]) else set()
    has_session_time = len(data.runs) > 1 and has_one_clock(data.time_s, data.run)
    if not has_session_time and (zero is None or zero.rate is None):
        unseen.add(Kind.DRIFT)
    if never_returns(data.position, data.run):
        pressed = data.select(data.engaged) if data.engaged.any() else data
        one_pass = is_one_pass(pressed.time_s, pressed.position, pressed.run)
        unseen |= UNSEEN_IN_ONE_PASS if one_pass else {Kind.FRICTION}
        if one_pass and zero is not None and not zero.is_zero:
            unseen.remove(Kind.SENSOR_STATICS)
    return frozenset(unseen)


def _law(kind: Kind | tuple[Kind, ...], *columns: FloatArray, nonnegative: bool = False) -> FlexibleLaw:
    stacked = np.column_stack(columns) if columns else np.empty((0, 0))
    kinds = frozenset({kind} if isinstance(kind, Kind) else kind)
    return FlexibleLaw(kinds, stacked, np.full(stacked.shape[1], nonnegative))


def _unit(signal: FloatArray) -> FloatArray:
    """Divide a signal by its root mean square."""
    return np.asarray(signal / (float(np.sqrt(np.mean(signal**2))) or 1.0))


def _hinges(signal: FloatArray) -> FloatArray:
    """Evaluate hinge functions (m, k) of a signal (m,), which extrapolate linearly unlike hat functions."""
    low, high = float(signal.min()), float(signal.max())
    steps = np.quantile(np.abs(signal[signal != 0.0]), _KNOTS) if np.any(signal) else np.zeros(1)
    knots = np.unique(np.concatenate([[0.0], steps, np.max(np.abs(signal)) * np.array(_KNOTS)]))
    up = [np.maximum(signal - knot, 0.0) for knot in knots if knot < high]
    down = [np.minimum(signal + knot, 0.0) for knot in knots if knot < -low]
    return np.column_stack([*up, *down]) if up or down else signal[:, None]


def _relaxation(
    blocked: BlockedData, touching: FloatArray, shortest_s: float
) -> Callable[[FloatArray], list[FloatArray]]:
    """Return a function that relaxes a strain (m,) with several time constants from `shortest_s` on."""
    time_s, run, data = blocked.time_s, blocked.run, blocked.data
    step = sample_time(time_s, run)
    longest = max(2.0 * longest_run(time_s, run), 40.0 * step)
    shortest = min(max(4.0 * step, shortest_s), 0.1 * longest)
    taus = np.geomspace(shortest, longest, round(_TIMES_PER_DECADE * np.log10(longest / shortest)) + 1)

    def relaxed(strain: FloatArray) -> list[FloatArray]:
        if data.kind is ChannelKind.CONTACT:
            held = blocked.reduce(pressed_samples(data).astype(np.float64)) > 0.5
            states = (
                remaining_strain(partial(relax, tau_s=tau), strain, time_s, run, data, held) for tau in taus
            )
            return [state * touching for state in states]
        return [np.asarray(strain - low_pass(strain, time_s, run, tau)) for tau in taus]

    return relaxed


def _sensor_dynamics(
    blocked: BlockedData, base: BaseColumns | None, effort: FloatArray, time_s: FloatArray, used: BoolArray
) -> list[FlexibleLaw]:
    """Build the laws of a sensor with a lag, a delay or a lead, for several time constants."""
    # A model fitted without the dynamics can be far from the true effort: delayed readings can hide inertia.
    # Columns of `base` are therefore refitted for each time constant, and only the best ones are used.
    run = blocked.run
    step = sample_time(time_s, run)
    longest_s = min(_LONGEST_LAG * blocked.data.time_scale, _LONGEST_LAG_S)
    times = [longest_s * lag for lag in _LAGS if longest_s * lag > step]
    unchanged = (float(np.sum((blocked.effort - effort)[used] ** 2)), effort)

    def refitted(sense: Sense) -> tuple[float, FloatArray]:
        if base is None:
            return unchanged
        columns = sense(base.columns)[used]
        size = np.sqrt(np.mean(columns**2, axis=0))
        size = np.where(size > 0.0, size, 1.0)
        columns = columns / size
        residual = (blocked.effort - sense(effort))[used]
        system = columns.T @ columns + COLLINEAR * len(columns) * np.eye(len(size))
        lower, upper = (base.lower - base.gains) * size, np.full(len(size), np.inf)
        change = solve_within_bounds(system, columns.T @ residual, lower, upper)
        return float(np.sum((residual - columns @ change) ** 2)), effort + base.columns @ (change / size)

    def lagged(tau_s: float) -> Sense:
        return partial(low_pass, time_s=time_s, run=run, tau_s=tau_s)

    def delayed(delay_s: float) -> Sense:
        return partial(shift, time_s=time_s, run=run, delay_s=delay_s)

    def leading(lead_s: float) -> Sense:
        return delayed(-lead_s)

    columns, closest = list[FloatArray](), [unchanged, *(refitted(leading(lead)) for lead in times)]
    families = (lagged, delayed, leading) if is_stepwise_command(blocked.data) else (lagged, delayed)
    for family in families if times else ():
        fits = {lag: refitted(family(lag)) for lag in times}
        for _ in range(_BISECTIONS if base is not None else 0):
            near = np.array(_near_best(fits))
            fits |= {lag: refitted(family(lag)) for lag in np.sqrt(near[1:] * near[:-1]).tolist()}
        chosen = times if base is None else _near_best(fits)
        columns += [family(lag)(fits[lag][1]) - fits[lag][1] for lag in chosen]
        closest += fits.values()
    effort = min(closest, key=lambda fit: fit[0])[1]
    return [
        _law(Kind.SENSOR_DYNAMICS, derivative(effort, time_s, run)),
        _law(Kind.SENSOR_DYNAMICS, *columns, nonnegative=True),
    ]


def _near_best(fits: Mapping[float, tuple[float, FloatArray]]) -> list[float]:
    """Return the time constant with the smallest error and its neighbors, in ascending order."""
    times = sorted(fits)
    best = times.index(min(times, key=lambda lag: fits[lag][0]))
    return times[max(best - 1, 0) : best + 2]


def _friction(
    blocked: BlockedData, unit_speed: FloatArray, depth: FloatArray, slope: FloatArray, touching: FloatArray
) -> list[FloatArray]:
    """Build the columns of friction and, for a joint, of play (the link lags behind the position)."""
    directions = [np.tanh(unit_speed / share) for share in _DIRECTION_WIDTHS]
    paths = [reversal_memory(depth, blocked.run, share) * touching for share in _REVERSAL_PATHS]
    columns = [
        *(half(direction, 0.0) for direction in directions for half in (np.maximum, np.minimum)),
        *paths,
    ]
    if blocked.data.kind is not ChannelKind.CONTACT and slope.any():
        columns += [-slope * path for path in paths]
    if "load" in blocked.data.context:
        columns.append(directions[-1] * np.abs(blocked.reduce(blocked.data.context["load"])))
    return columns


def _contact_geometry(
    position: FloatArray, depth: FloatArray, touching: FloatArray, run: IntArray
) -> list[FlexibleLaw]:
    """Build laws of a shifted surface, a plastic set (share of the deepest indentation), and adhesion."""
    after_contact = running_max((position > 0.0).astype(np.float64), run) * (position <= 0.0)
    # A plastic set reduces a spring's strain, and for a quadratic spring the square of the strain.
    reaches = np.max(position, initial=1e-9) * np.array(_ADHESION_RANGES)
    adhesion = after_contact[:, None] * np.exp(np.minimum(position, 0.0)[:, None] / reaches)
    strain = (_unit(depth) * touching)[:, None]
    left_strain = np.maximum(strain - running_max(strain[:, 0], run)[:, None] * np.array(_PLASTIC_SETS), 0.0)
    deepest = float(np.max(position, initial=0.0)) or 1.0
    raised = [np.clip(position / deepest + share, 0.0, share) for share in _SURFACE_HEIGHTS]
    columns = np.column_stack([touching, left_strain - strain, *raised])
    surface = FlexibleLaw(frozenset({Kind.CONTACT_GEOMETRY}), columns, np.arange(columns.shape[1]) > 0)
    interaction = (Kind.ELASTIC_SHAPE, Kind.CONTACT_GEOMETRY)
    pull = _law(Kind.CONTACT_GEOMETRY, -touching, -adhesion, nonnegative=True)
    softened = _law(interaction, left_strain**2 - strain**2, nonnegative=True)
    return [surface, softened, replace(pull, one_sided=False)]


def _sensor_statics(
    predicted: FloatArray,
    measured: FloatArray,
    run: IntArray,
    base: BaseColumns | None,
    engaged: BoolArray,
    *,
    has_bias: bool,
) -> FlexibleLaw:
    """Build the law of a sensor's bias, gain, saturation, dead band and hysteresis.

    A gain is added only if the base model's own gains cannot imitate it, and dead bands only if readings
    under load may show them. Free air rules out a bias if it shows a correct zero. Hysteresis of the sensor
    lowers the reading while the effort grows; friction raises it.
    """
    low, high = np.quantile(measured, [0.001, 0.999])
    saturation = [
        -np.maximum(predicted - _FULL_SCALE * high, 0.0) * (high > 0.0),
        -np.minimum(predicted - _FULL_SCALE * low, 0.0) * (low < 0.0),
    ]
    sigma = noise_between_samples(measured, run, engaged)
    widths = [share * float(np.ptp(predicted)) for share in _DEAD_BANDS]
    widths = [width for width in widths if may_have_dead_band(measured[engaged], width, sigma)]
    linear = [np.ones(len(predicted))] * has_bias
    if base is not None:
        left = _residual(base.columns, predicted, [np.arange(len(predicted))])
        if not left @ left <= _SPANNED * (predicted @ predicted):
            linear.append(predicted)
    dead_bands = [-np.clip(predicted, -w, w) for w in widths]
    hysteresis = [-reversal_memory(predicted, run, share) for share in _REVERSAL_PATHS]
    columns = np.column_stack([*linear, *saturation, *dead_bands, *hysteresis])
    return FlexibleLaw(frozenset({Kind.SENSOR_STATICS}), columns, np.arange(columns.shape[1]) >= len(linear))


def periodic_columns(
    position: FloatArray, residual: FloatArray, *, is_angle: bool, run: IntArray | None = None
) -> FloatArray:
    """Select sines and cosines over the position, (m, 2 waves), that describe a residual.

    Wave numbers are whole numbers per turn if a revolute axis covers about a turn, otherwise whole numbers
    over the range. Waves are selected one by one and fitted jointly (orthogonal matching pursuit, Pati et al.
    1993).

    Args:
        position: shape (m,) [rad or m].
        residual: shape (m,) [effort].
        is_angle: whether the axis is revolute.
        run: shape (m,), for waves with their own phase and amplitude in each run; None for common waves.
    """
    span = float(np.ptp(position))
    if span == 0.0:
        return np.empty((len(position), 0))
    whole_turns = is_angle and span > _WHOLE_TURN * 2.0 * np.pi
    unit, min_wave = (1.0, 2) if whole_turns else (2.0 * np.pi / span, _MIN_WAVES)
    phase = position * unit / (2.0 * np.pi)
    phase = phase % 1.0 if whole_turns else phase - phase.min()
    bins = np.minimum((phase * _BINS).astype(np.int64), _BINS - 1)
    limit = min(len(np.unique(bins)) // 3, _BINS // 4)
    parts = [np.arange(len(position))] if run is None else rows_of_runs(run)
    smooth = np.column_stack([np.ones(len(position)), position - position.mean()])
    columns, chosen = list[FloatArray](), list[int]()
    left = _residual(smooth, residual, parts)
    while len(chosen) < _MAX_WAVES and limit > min_wave:
        spectra = [np.fft.rfft(np.bincount(bins[p], weights=left[p], minlength=_BINS))[:limit] for p in parts]
        power = np.sum(np.abs(spectra) ** 2, axis=0)
        power[:min_wave] = 0.0
        power[chosen] = 0.0
        wave = int(np.argmax(power))
        angle = position * unit * wave
        after = _residual(np.column_stack([smooth, *columns, np.sin(angle), np.cos(angle)]), residual, parts)
        if after @ after > (1.0 - _MIN_WAVE_SHARE) * (left @ left):
            break
        chosen.append(wave)
        columns += [np.sin(angle), np.cos(angle)]
        left = after
    return np.column_stack(columns) if columns else np.empty((len(position), 0))


def _residual(columns: FloatArray, signal: FloatArray, parts: list[IntArray]) -> FloatArray:
    """Return the residual of a signal (m,) after separate fits of columns (m, k) to each part."""
    residual = signal.copy()
    for rows in parts:
        residual[rows] -= columns[rows] @ np.linalg.lstsq(columns[rows], signal[rows], rcond=None)[0]
    return residual
