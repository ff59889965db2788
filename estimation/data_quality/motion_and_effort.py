"""Check whether motion and effort are consistent in their units, times and signs."""

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.measured_derivatives import mistaken_scale
from palpate.estimation.fit.blocks import HEAVY, LUMPED_GAINS
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import number_stretches, runs_by_time
from palpate.estimation.signals.runwise import is_even, sample_time
from palpate.estimation.statistics.correlation import correlation_coefficient, noise_between_samples
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.types import FloatArray

SLID = "slid along the surface"  # part of the reason for tilted presses
_MAX_LATERAL_RATIO = 0.1  # ratio to the depth, at whose angle a stiffness along the tool is 1 % too small
_MAX_DEPTH_M = 0.2  # a deeper indentation means a wrong unit
_MAX_SLOPE_N_M = 1e7
_MIN_SLOPE_N_M = 1e-2
# Indentations below this depth come from microscopes, since a wrong unit would make them deeper. Cells under
# a cantilever have slopes of 1e-4 to 1e-1 N/m.
_MICROSCOPIC_M, _MIN_MICROSCOPIC_N_M = 1e-5, 1e-5
_MAX_NOISE_RAD = 0.02  # largest standard deviation of an encoder's noise
_MAX_SPEED_RAD_S = 300.0
_MIN_PRESSED = 0.01  # least share of samples in contact
# At least one in twenty samples in contact must exceed free air by 4 standard deviations of the noise; of
# pure noise, 1 in 16 000 does.
_AIR_SIGMAS, _QUANTILE = 4.0, 0.95
# Ratio to the noise between neighboring readings above which readings do not look like noise. The colored
# noise of sensors reaches about 5.
_SMOOTH = 6.0
_DEPTH_SLICES = 20  # slices of the depth in which the start of the force is located
# Least share of the deepest indentation without force, and largest noise relative to a spring's force there.
_MIN_SILENT, _MAX_NOISE = 0.2, 0.25
_SHIFTS_S = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # tried time offsets of clocks that were started by hand
# Correlations of depth and force: those of springs exceed the first, those of unrelated signals are below the
# second.
_RELATED, _UNRELATED = 0.9, 0.5
_NEGATIVE = -0.5  # correlation of depth and force below which one of them has the wrong sign
_CHANCE_SIGMAS = 4.0  # standard errors that a correlation must exceed
_MIN_EXPLAINED = 0.1  # share of the force's variance that depth and velocity explain for any object
_EQUAL = 1e-9  # largest difference of two identical columns, relative to the force's range
_MIN_TURNS = 2.0  # least number of turns; over fewer, the shape alone can distinguish a spring from a weight
_MIN_SLOW = 0.1  # least share of the effort's variance that varies slowly with the angle
# Largest share of the energy unexplained by the motion that the sine in degrees may leave. Effects of ten
# times the noise left up to 0.1 for a pendulum in degrees.
_MAX_LEFT = 0.2
# Largest ratio of residual energies at which a law is as good as a wider one. Pendulums in degrees reached
# 1.01; a weight in radians reaches 1.1 if its amplitude is half the noise, and hundreds if it is clear.
_EQUIVALENT = 1.1
# Least ratio of residual energies at which a law is clearly worse. Spiral and hardening springs reached 1.03;
# swings of a pendulum over 50 degrees reached 1.3 to 6.
_WORSE = 1.5


def mistaken_units(data: ChannelData) -> str | None:
    """Report a unit that is probably wrong; None if all are plausible.

    A contact's depth must be below 0.2 m, and its range of forces over this depth between 1e-2 and 1e7 N/m,
    or from 1e-5 N/m for a depth that only a microscope measures. At most a tenth of the samples of a joint
    with an angle may be faster than 300 rad/s.

    Args:
        data: the channel in SI units; its `units` are those of the source, which the message suggests to
            change.
    """
    if data.kind is ChannelKind.CONTACT:
        return _mistaken_unit_of_contact(data)
    fast = float(np.quantile(np.abs(data.velocity), 0.9))
    if not data.kind.is_angle or fast <= _MAX_SPEED_RAD_S:
        return None
    problem = (
        f"the joint turns faster than {_MAX_SPEED_RAD_S:g} rad/s: a tenth of the samples exceed "
        f"{fast:.3g} rad/s"
    )
    remedies = []
    if data.units.get("position") != "deg":
        remedies.append("if the angle is in degrees, use --unit position=deg")
    if data.units.get("time") not in {None, "s"}:  # a longer unit of time makes the joint slower
        remedies.append("if the time is in seconds, use --unit time=s")
    return f"{problem}; {'; '.join(remedies) or 'check the unit of the time'}"


def _mistaken_unit_of_contact(data: ChannelData) -> str | None:
    """Report an implausible depth or stiffness, with a unit that would be more plausible."""
    deepest = float(np.abs(data.position).max())
    if deepest > _MAX_DEPTH_M:
        problem = f"the deepest indentation is {deepest:.3g} m, more than {_MAX_DEPTH_M:g} m"
        if _may_be_si(data, "displacement"):
            return f"{problem}; if the displacement is in millimeters, use --unit displacement=mm"
        return (
            f"{problem}; if the displacement is not in {data.units['displacement']}, give its unit with "
            "--unit displacement=UNIT"
        )
    slope = float(np.ptp(data.effort)) / max(deepest, 1e-12)
    least = _MIN_SLOPE_N_M if deepest > _MICROSCOPIC_M else _MIN_MICROSCOPIC_N_M
    if slope == 0.0 or least < slope < _MAX_SLOPE_N_M:
        return None
    likely = {"force": "mN"} if slope > least else {"displacement": "mm", "force": "kN"}
    options = [f"--unit {name}={unit}" for name, unit in likely.items() if _may_be_si(data, name)]
    example = f", such as {' or '.join(options)}" if options else " with --unit"
    return (
        f"force over depth is {slope:.3g} N/m, outside {least:g} to {_MAX_SLOPE_N_M:g} N/m; if a unit is "
        f"wrong, correct it{example}"
    )


def _may_be_si(data: ChannelData, quantity: str) -> bool:
    """Return whether numbers may be in another unit: SI, as palpate's names state, may be wrong."""
    return data.units.get(quantity) in {None, "m", "N"}


def mistaken_times(data: ChannelData) -> str | None:
    """Report a velocity that contradicts the position, because of wrong times or a wrong unit.

    The import of files discards such a velocity; this check is for other sources. A velocity that was derived
    from the position follows it except for its smoothing. Means over unevenly spaced readings give no answer,
    since a mean of such velocities is not the velocity of the mean position. A velocity of zero throughout
    describes a static measurement, whose position changes between readings.

    Args:
        data: the channel.
    """
    is_derived = bool(data.units) and "velocity" not in data.units
    if is_derived or (data.averaged > 1 and not is_even(data.time_s, data.run)):
        return None
    ratio = mistaken_scale(data.time_s, data.position, data.velocity, data.run)
    if ratio is None or (np.isnan(ratio) and not data.velocity.any()):
        return None
    if np.isnan(ratio):
        return "the velocity does not follow the position; check times and the choice of columns"
    return f"the velocity is {ratio:.3g} times the slope of the position; check times and units"


def misaligned(data: ChannelData) -> str | None:
    """Report a time shift at which force and depth correlate far better; None without one.

    The check does not apply if depth and velocity explain the force: the force of a damper follows the
    velocity, which looks like a shifted position in periodic motion.

    Args:
        data: the channel.
    """
    if data.kind is not ChannelKind.CONTACT or not data.engaged.any() or _share_explained(data) > _UNRELATED:
        return None
    pressed = np.where(data.engaged, data.position, 0.0)
    step = sample_time(data.time_s, data.run)
    correlation = correlation_coefficient(pressed, data.effort)
    for seconds in _SHIFTS_S:
        shift = round(seconds / step)
        if shift and abs(shift) < len(pressed) // 4:
            shifted = correlation_coefficient(np.roll(pressed, shift), data.effort)
            if shifted > _RELATED and correlation < _UNRELATED:
                side = "late" if seconds > 0.0 else "early"
                return (
                    f"the force is {abs(seconds):.1f} s {side} relative to the motion (correlation "
                    f"{shifted:.2f} if shifted, {correlation:.2f} as recorded); align force and motion in "
                    "the file"
                )
    return None


def no_contact(data: ChannelData) -> str | None:
    """Report a missing contact or a wrong sign; None if there is a contact.

    A force that falls with depth is not reported if it first rises, as before an object tears.

    Args:
        data: the channel; a joint is not reported.
    """
    if data.kind is not ChannelKind.CONTACT:
        return None
    pressed, air_level = data.engaged, 0.0
    if pressed.mean() < _MIN_PRESSED:
        return "no contact: the displacement is never positive; press the object"
    if not pressed.all():
        air_level, noise = _free_air_level(data)
        is_small = np.quantile(np.abs(data.effort[pressed] - air_level), _QUANTILE) < noise
        # Readings that change slowly are not noise: an object may begin to push above the assumed surface.
        is_noise = noise < _AIR_SIGMAS * _SMOOTH * noise_between_samples(data.effort, data.run, ~pressed)
        if is_small and is_noise and misaligned(data) is None:
            return "no contact: the force during the presses does not exceed the noise in free air"
    depth, peak = np.where(pressed, data.position, 0.0), int(np.argmax(np.abs(data.effort))) + 1
    trend = correlation_coefficient(depth, data.effort)
    rises = correlation_coefficient(depth[:peak], data.effort[:peak]) > -_NEGATIVE  # before the object tears
    # Negative if a spring from the surface on has a negative stiffness.
    is_negative = float(depth @ (data.effort - air_level)) < 0.0
    if is_negative and trend < _NEGATIVE and not rises and misaligned(data) is None:
        unit = data.units.get("force") or "N"
        opposite = unit[1:] if unit.startswith("-") else f"-{'1' * unit[0].isalpha()}{unit}"
        return (
            f"force falls with depth (correlation {trend:.2f}); check the signs of force and displacement: "
            f"--unit force={opposite} reverses the force"
        )
    return None


def tilted(data: ChannelData) -> str | None:
    """Report presses of a probing session along which the tip slides on the surface; None without them.

    If a press is tilted from the normal of a smooth surface, the force pushes the tip along the surface, and
    the force over the depth along the tool falls with the square of the cosine of the tilt.

    Args:
        data: the channel.
    """
    if data.lateral_ratio <= _MAX_LATERAL_RATIO:
        return None
    return (
        f"the tip {SLID} in every press: it moved sideways by at least {100.0 * data.lateral_ratio:.0f} % of "
        "its depth, but not in free air; press along the surface normal (press_direction_world of the plan)"
    )


def late_touch(data: ChannelData) -> str | None:
    """Report the depth at which the force begins if it is clearly below the surface; None otherwise.

    The force must stay within its noise over at least a fifth of the depth, where the force of a spring that
    begins at the surface would exceed the noise. If it exceeds the noise there in the first contact, the
    object had not recovered when it was pressed again.

    Args:
        data: the channel.
    """
    pressed = data.engaged
    if data.kind is not ChannelKind.CONTACT or data.surface is not None or pressed.all() or not pressed.any():
        return None
    air_level, noise = _free_air_level(data)
    force, depth = np.abs(data.effort[pressed] - air_level), data.position[pressed]
    deepest, silent = float(depth.max()), 0.0
    for end in np.linspace(0.0, deepest, _DEPTH_SLICES + 1)[1:]:
        forces = force[(depth > silent) & (depth <= end)]
        if len(forces) and np.quantile(forces, _QUANTILE) >= noise:
            break
        silent = float(end)
    expected = float(force.max()) * silent / deepest  # force of a spring that begins at the surface
    if silent < _MIN_SILENT * deepest or noise > _MAX_NOISE * expected:
        return None
    stays = (
        f"the force stays at its free-air level down to a displacement of {1e3 * silent:.3g} mm (the largest "
        f"is {1e3 * deepest:.3g} mm)"
    )
    order = np.concatenate([np.arange(rows.start, rows.stop) for rows in runs_by_time(data.time_s, data.run)])
    contact = number_stretches(pressed[order], data.run[order])
    first = order[contact == contact[np.argmax(pressed[order])]]
    loading = first[: np.argmax(np.abs(data.effort[first] - air_level))]
    shallow = np.abs(data.effort[loading] - air_level)[data.position[loading] <= silent]
    if len(shallow) and np.median(shallow) >= noise:
        return (
            f"after the first contact, {stays}, so the object has not recovered when it is pressed again. If "
            "each contact should begin at the undeformed surface, rest longer between contacts"
        )
    return (
        f"{stays}; if the surface is that deep, subtract this depth from the "
        "displacement, or run `palpate add FILE contact_offset`"
    )


def _free_air_level(data: ChannelData) -> tuple[float, float]:
    """Return the level of the effort in free air, and the least distance of a press from it [effort]."""
    air = data.effort[~data.engaged]
    level = float(np.median(air))
    return level, _AIR_SIGMAS * MAD_TO_SIGMA * float(np.median(np.abs(air - level)))


def unresolved_inertia(data: ChannelData, model: Model | None) -> str | None:
    """Report an inertia that the base model holds at zero; None otherwise.

    Args:
        data: not used; all checks that need a model are called with both.
        model: the base model; None if unknown, and the result is then None.
    """
    if model is None or not any(f"{name}.{gain}" in model.held for name, gain in LUMPED_GAINS.items()):
        return None
    return (
        "the acceleration is mainly measurement error, so the inertia is held at 0; to fit the inertia, "
        "record a faster motion"
    )


def unrelated(data: ChannelData) -> str | None:
    """Report a force that hardly depends on the motion, or is a multiple of the depth; None otherwise.

    Depth and velocity must explain at least a tenth of the variance that the force has in contact.

    Args:
        data: the channel; a joint is not reported.
    """
    if data.kind is not ChannelKind.CONTACT or not data.engaged.any():
        return None
    pressed = data.select(data.engaged)
    stiffness = float(pressed.effort @ pressed.position) / (float(pressed.position @ pressed.position) or 1.0)
    if np.max(np.abs(pressed.effort - stiffness * pressed.position)) < _EQUAL * float(np.ptp(pressed.effort)):
        return (
            f"the force equals the displacement times {stiffness:.6g} N/m in every row, which no sensor "
            "measures; was one column used for both? Name the column of the force with --column force=COLUMN"
        )
    share = _share_explained(data)
    if share < _MIN_EXPLAINED:
        return (
            f"depth and velocity explain only {100.0 * share:.0f} % of the force; is the right column read "
            "as the force? If not, name it with --column force=COLUMN"
        )
    return None


def at_rest(data: ChannelData) -> str | None:
    """Report a joint whose position is only noise and unrelated to the effort; None otherwise.

    An angle that varies by degrees is not encoder noise: each row then holds another pose. Position and
    effort are compared without the means of the runs.

    Args:
        data: the channel; a contact is not reported.
    """
    if data.kind is ChannelKind.CONTACT:
        return None
    _, index = np.unique(data.run, return_inverse=True)
    moved, effort = (
        signal - (np.bincount(index, signal) / np.bincount(index))[index]
        for signal in (data.position, data.effort)
    )
    pairs = np.flatnonzero(np.diff(data.run) == 0)
    products = [
        (moved[pairs], moved[pairs + 1]),  # motion correlates from sample to sample, noise does not
        (moved, effort),
        (moved**2 - np.mean(moved**2), effort),
    ]
    for first, second in products:
        chance = float(np.linalg.norm(first) * np.linalg.norm(second)) / np.sqrt(max(len(first), 1))
        if abs(float(first @ second)) > _CHANCE_SIGMAS * chance:
            return None
    if data.kind.is_angle and np.std(moved) > _MAX_NOISE_RAD:
        return None
    size = f"{np.std(moved):.2g} {data.position_unit}"
    return f"the position varies at random by {size}, and the effort does not follow it; move the joint"


def _share_explained(data: ChannelData) -> float:
    """Return the share of the force's variance in contact that depth and velocity explain, 0 to 1."""
    pressed = data.select(data.engaged)
    if np.ptp(pressed.effort) == 0.0:
        return 0.0
    motion = np.column_stack([pressed.position, pressed.velocity, np.ones(len(pressed))])
    residual = pressed.effort - motion @ solve(motion, pressed.effort)
    return 1.0 - float(np.var(residual) / np.var(pressed.effort))


def angle_in_degrees(data: ChannelData, model: Model | None) -> str | None:
    """Report the angle of a joint that is probably in degrees; None otherwise.

    Over several turns, the torque of an arm's weight repeats with each turn. If the effort does not repeat
    but varies slowly over the range of the angle, the angle is probably in degrees, or it is the angle of a
    motor before its gear. If the effort does repeat, a slow variation comes from a wound spring or a changing
    friction. If the model has no weight, the angle is reported only if a sine in degrees fits the effort and
    a spiral spring does not.

    Args:
        data: the channel.
        model: the base model; None if unknown, and the result is then None.
    """
    if data.kind is not ChannelKind.REVOLUTE or model is None:
        return None
    turns = float(np.ptp(data.position)) / (2.0 * np.pi)
    if turns < _MIN_TURNS:
        return None
    radian_law = [np.sin(data.position), np.cos(data.position)]
    degree_law = [np.sin(np.radians(data.position)), np.cos(np.radians(data.position))]
    laws: list[list[FloatArray]] = [[], degree_law, [*degree_law, *radian_law]]
    without, in_degrees, in_both = (_mean_squared_residual(data, law) for law in laws)
    is_large = without - in_degrees >= _MIN_SLOW * float(np.var(data.effort))
    if not is_large or in_degrees > min(_MAX_LEFT * without, _EQUIVALENT * in_both):
        return None
    if not any(effect.name in HEAVY for effect in model.effects):  # as well as a cubic, not as a quadratic
        x = (data.position - data.position.mean()) / float(np.std(data.position))
        quadratic, cubic = (_mean_squared_residual(data, law) for law in ([x, x**2], [x, x**2, x**3]))
        if in_degrees > _EQUIVALENT * cubic or quadratic < _WORSE * in_degrees:
            return None
    is_unclear = data.units.get("position") != "deg"
    return (
        f"the joint turns {turns:.0f} times, but its effort does not repeat in each turn, although a "
        "weight's torque would; "
        + "if the angle is in degrees, use --unit position=deg; " * is_unclear
        + "if the angle is the motor's, divide it by the gear ratio"
    )


def _mean_squared_residual(data: ChannelData, law: list[FloatArray]) -> float:
    """Return the mean squared residual of a law (columns) together with friction, drift and inertia."""
    v, zero, drift = data.velocity, np.ones(len(data)), data.time_s - data.time_s[0]
    columns = np.column_stack([zero, drift, v, np.sign(v), v * np.abs(v), *law, data.acceleration])
    gains = solve(columns, data.effort)
    if gains[-1] < 0.0:  # a swing's acceleration correlates with its angle, but inertia is not negative
        columns = columns[:, :-1]
        gains = solve(columns, data.effort)
    return float(np.mean((data.effort - columns @ gains) ** 2))
