"""Sensor statics: zero, gain, range, dead band, hysteresis and quantization."""

from functools import lru_cache

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect, Errors, Inner, Parameter, Parameters, SensorEffect
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.signals.free_air import may_have_dead_band, zero_in_free_air
from palpate.estimation.signals.motion import is_monotonic
from palpate.estimation.signals.runwise import play
from palpate.estimation.statistics.correlation import noise_between_samples
from palpate.robot_io.types import FloatArray, IntArray

_OFF = 0.5  # largest difference of the zero in free air, relative to the fitted offset
_TAILS = (0.01, 0.99)  # quantiles that define the range of the readings
GAIN_DEVIATIONS = np.array([0.003, 0.01, 0.03, 0.1, 0.25, 0.5])  # start values of a gain's deviation from 1


class Bias(AdditiveEffect):
    name = "bias"
    kind = Kind.SENSOR_STATICS
    physics = "The sensor reads a constant value when no force acts."
    equation = "reading = effort + b"
    source = "JCGM 200:2012 (VIM), 4.20: instrumental bias"
    signature = "all readings have the same offset, also in free air"
    signals = ("offset",)
    one_sided = False
    gains = (Parameter("offset", "{effort}", -1e12, 1e12, (-1.0, 1.0)),)
    confused_with = {
        "run_offset": "record more runs: a bias is the same in all runs",
        "contact_offset": "record free air: a bias also appears there",
        "gravity_tilt": "fit all joints together (a tilt affects all of them), or move over a wide range",
        "payload": "fit all joints together (a payload affects all of them), or change the posture",
        "drift": "wait: a bias stays",
        "asymmetric_friction": "let the joint rest: a bias remains, but asymmetric friction vanishes",
        "coulomb_friction": "reverse the motion: friction then acts the other way, but a bias does not",
    }

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: a contact needs free air, else a bias looks like a shifted surface."""
        is_contact = data.kind is ChannelKind.CONTACT
        return super().applies_to(data) and not (is_contact and zero_in_free_air(data) is None)

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: readings in free air do not have the fitted offset."""
        zero = zero_in_free_air(data)
        if zero is None:
            return False
        offset = parameters[f"{self.name}.offset"]
        return abs(zero.bias - offset) > max(_OFF * abs(offset), zero.noise)

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.ones((len(data), 1))


class TorqueGain(SensorEffect):
    name = "torque_gain"
    kind = Kind.SENSOR_STATICS
    physics = "The torque constant or the gear ratio in use differs from the true one."
    equation = "reading = gain effort"
    source = "M. Gautier, S. Briot, J. Dyn. Sys. Meas. Control 136 (2014): identification of drive gains"
    signature = "the effort is scaled by one factor; only a model with a known mass can show this factor"
    signals = ("effort",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (Parameter("gain", "1", 0.2, 5.0, (0.6, 1.6), log=True),)
    confused_with = {
        "run_gain": "record more runs: a wrong constant is the same in all runs",
        "payload": "change the posture",
        "load_dependent_friction": "lift and lower the same load",
        "bias": "lift two loads: the error of a gain grows with the load",
    }
    linear = True
    pointwise = True

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({"gain": float(gain)} for gain in np.exp([*-GAIN_DEVIATIONS[::-1], *GAIN_DEVIATIONS]))

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return inner["gain"] * effort


class ForceSensorError(AdditiveEffect):
    """effort = share J^T p e with the force sensor's error e, estimated from all other joints.

    See `arm_signals` for e. Any error of the force sensor (lag, hysteresis, saturation) appears in all joints
    as the same difference from its reading. The diagnosis of the contact channel identifies the error.
    """

    name = "force_sensor_error"
    kind = Kind.SENSOR_STATICS
    physics = "The force sensor is wrong; all joints carry the true force."
    equation = "effort = share J^T p e, e estimated from the other joints"
    source = "J. J. Craig, Introduction to Robotics (2005), ch. 5.10: forces at the tip and torques of joints"
    signature = "in contact, the errors of all joints match one force at the tip"
    signals = ("load",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    # The share is near one; noise in the torques of the other joints lowers it.
    gains = (Parameter("share", "1", 0.5, 1.5, (0.9, 1.1)),)
    needs = ("contact_torque_per_newton", "force_beyond_reading")
    confused_with = {
        "force_deadband": "press at several forces: a dead band reduces all readings by the same amount",
        "payload": "compare free air with contact: a payload acts in both",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return (data.context["contact_torque_per_newton"] * data.context["force_beyond_reading"])[:, None]

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: the joint's error differs from the force that the other joints carry."""
        (share,) = self.gains
        return not share.lower < parameters[f"{self.name}.{share.name}"] < share.upper


class Deadband(SensorEffect):
    name = "deadband"
    kind = Kind.SENSOR_STATICS
    physics = "Friction or a threshold in the sensor hides the first part of any effort."
    equation = "reading = effort - clip(effort, -width, width)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: threshold"
    signature = "readings are zero for small efforts, and too small by a constant for larger ones"
    signals = ("effort",)
    inner = (Parameter("width", "{effort}", 1e-15, 1e9, (0.001, 1.0), log=True),)
    start_multiples = {"width": ("largest_effort", np.geomspace(0.01, 0.4, 8))}
    confused_with = {
        "contact_offset": "probe slowly near the surface",
        "bias": "look at both signs of effort",
        "coulomb_friction": "hold still under several loads",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return effort - np.clip(effort, -inner["width"], inner["width"])

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: readings pass through zero without staying there, or never come near it.

        In free air, every sensor reads zero, so these readings show nothing. If all efforts lie far on one
        side of zero, a dead band is a bias.
        """
        sigma = min(noise, noise_between_samples(data.effort, data.run, data.engaged))
        readings, width = data.effort[data.engaged], parameters[f"{self.name}.width"]
        is_far = readings.min(initial=np.inf) > width or readings.max(initial=-np.inf) < -width
        return bool(is_far) or not may_have_dead_band(readings, width, sigma)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(np.abs(effort) > inner["width"], 1.0, 0.0)[:, None] * columns


class ForceDeadband(AdditiveEffect):
    """Force hidden by the force sensor's dead band; in the contact channel it looks like a deeper surface."""

    name = "force_deadband"
    kind = Kind.SENSOR_STATICS
    physics = "The force sensor does not show the first part of any force, but the joints carry it."
    equation = "effort = w J^T p while touching, p the press direction"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: threshold; J^T F by virtual work"
    signature = (
        "in contact, the errors of all joints match one additional force at the tip, which does not grow "
        "with the contact force"
    )
    signals = ("load",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (Parameter("width", "N", 0.0, 1e12, (0.01, 10.0)),)
    needs = ("contact_torque_per_newton", "touching")
    confused_with = {
        "torque_gain": "press at several forces: a dead band reduces all readings by the same amount",
        "force_sensor_error": "press at several forces: a dead band reduces all readings by the same amount",
        "payload": "compare free air with contact: a payload acts in both",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return (data.context["contact_torque_per_newton"] * data.context["touching"])[:, None]


# At most the share `_OF_THOSE` of readings beyond the limit may exceed it by more than `_NOISE` standard
# deviations, or by more than the share `_OF_LIMIT` of the limit: the residual of a wrong model can be larger
# than the noise of any sensor.
_NOISE, _OF_LIMIT, _OF_THOSE = 4.0, 0.1, 0.05
_ORDER = 6  # order of the polynomial that is fitted to readings beyond the limit
_FEWEST_OF_CURVE = 10 * _ORDER  # readings needed in a run
# Readings follow a curve if the polynomial leaves less than this share of their variance beyond white noise.
# For a random walk, the slowest noise, it leaves 2 % or more in 99 of 100 cases.
_OF_CURVE = 0.02
_OF_WHITE = 20.0  # variance of third differences of white noise of variance 1
_ABOVE_NOISE = 2.0  # ratio to the variance of white noise below which readings count as constant


class Saturation(SensorEffect):
    name = "saturation"
    kind = Kind.SENSOR_STATICS
    physics = "Beyond its range, the sensor shows the limit of the range."
    equation = "reading = clip(effort, -limit, limit)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: span"
    signature = "the largest readings are cut off flat at one value"
    signals = ("effort",)
    inner = (Parameter("limit", "{effort}", 1e-15, 1e9, (0.1, 100.0), log=True),)
    start_multiples = {"limit": ("largest_effort", (0.55, 0.7, 0.8, 0.88, 0.94, 0.97, 0.99))}
    confused_with = {
        "layered_stiffness": "reduce the load: readings below the limit are correct",
        "cubic_stiffness": "reduce the load: readings below the limit are correct",
    }
    linear = False

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return np.clip(effort, -inner["limit"], inner["limit"])

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return np.where(np.abs(effort) < inner["limit"], 1.0, 0.0)[:, None] * columns

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: readings exceed the limit by more than noise, or follow a curve."""
        limit = parameters[f"{self.name}.limit"]
        above = np.abs(data.effort) - limit
        beyond = above > 0.0
        if np.sum(above > min(_NOISE * noise, _OF_LIMIT * limit)) > _OF_THOSE * np.sum(beyond):
            return True
        number, position = np.arange(len(data), dtype=np.float64), data.position
        motion = np.column_stack([position, data.velocity, data.velocity * position])
        return any(
            _follows_a_curve(above[beyond], signals[beyond], data.run[beyond])
            for signals in (number[:, None], motion)
        )


def _follows_a_curve(readings: FloatArray, signals: FloatArray, run: IntArray) -> bool:
    """Return whether readings beyond a limit follow signals smoothly in each run.

    A saturated reading stays constant while the effort changes. Readings of an unsaturated sensor vary with
    the motion. The first of the signals (m, k) enters as a polynomial, the others linearly.
    """
    total, sse, white = 0.0, 0.0, 0.0
    for number in np.unique(run):
        values, (at, *regressors) = readings[run == number], signals[run == number].T
        if len(values) >= _FEWEST_OF_CURVE:
            place = (at - at.min()) / (float(np.ptp(at)) or 1.0)
            columns = np.column_stack(
                [np.polynomial.legendre.legvander(2.0 * place - 1.0, _ORDER), *regressors]
            )
            residual = values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0]
            total += float(np.sum((values - values.mean()) ** 2))
            sse += float(residual @ residual)
            white += len(values) * float(np.mean(np.diff(values, 3) ** 2)) / _OF_WHITE
    return total > _ABOVE_NOISE * white and sse - white < _OF_CURVE * (total - white)


_STILL = 0.1  # change relative to the width below which an effort counts as constant


class Hysteresis(SensorEffect):
    """Reading that stays constant after a reversal until the effort has changed by twice the width.

    The initial state within this gap depends on the past: a reading stays high after a press. For a contact,
    it is taken from the readings in free air. A joint has no free air and starts in the middle of the gap.
    """

    name = "hysteresis"
    kind = Kind.SENSOR_STATICS
    physics = "Internal friction of the sensor delays its reading at each reversal of the effort."
    equation = "reading = play(effort, width)"
    source = "M. A. Krasnoselskii, A. V. Pokrovskii, Systems with Hysteresis (1989): play operator"
    signature = "readings are low while the effort rises and high while it falls, at any speed"
    signals = ("past effort",)
    inner = (Parameter("width", "{effort}", 1e-15, 1e9, (0.001, 1.0), log=True),)
    start_multiples = {"width": ("largest_effort", np.geomspace(0.01, 0.3, 7))}
    confused_with = {
        "bouc_wen_hysteresis": "reverse slowly at several loads: a sensor's loops all have the same width",
        "backlash": "reverse slowly at several loads: only a gap spans a fixed distance",
        "dry_friction": "reverse slowly at several depths",
        "coulomb_friction": "reverse slowly at several loads",
        "damping": "probe at two speeds",
    }
    linear = False

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: without a retraction, the hysteresis of a contact looks like a bias."""
        is_one_pass = data.kind is ChannelKind.CONTACT and is_monotonic(data.position, data.run)
        return super().applies_to(data) and not is_one_pass

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: readings that stay within the gap do not show it, like a constant."""
        return parameters[f"{self.name}.width"] > float(np.ptp(np.quantile(data.effort, _TAILS)))

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        width = inner["width"]
        if data.kind is not ChannelKind.CONTACT:
            return play(effort, data.run, width, None)
        # The mean reading of each run before the effort changes, shape (runs,) or (runs, p). Held-out
        # runs use their own readings too, since other runs do not determine the initial state of the sensor.
        starts, piece = block_index(data.run)
        moved = np.abs(effort - effort[starts][piece]) > _STILL * width
        reading, number = data.effort, np.arange(len(data))
        if effort.ndim == 2:
            reading, number = reading[:, None], number[:, None]
        until = np.minimum.reduceat(np.where(moved, number, len(data)), starts)
        still = number < until[piece]
        sums: FloatArray = np.add.reduceat(np.where(still, reading, 0.0), starts)
        at_first = sums / np.add.reduceat(still.astype(np.float64), starts)
        return play(effort, data.run, width, at_first)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: while the reading is held, the slope when it last followed the effort.

        In a contact the slope is zero until the reading first follows.
        """
        return self.follow(effort, columns, data, inner)[0]

    def follow(
        self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner
    ) -> tuple[FloatArray, FloatArray]:
        reading = self.sense(effort, data, inner)
        held = np.abs(effort - reading) < inner["width"] * (1.0 - 1e-9)
        first = np.append(True, np.diff(data.run) != 0)
        last = np.maximum.accumulate(np.where(held & ~first, 0, np.arange(len(effort))))
        slopes = columns.T.take(last, axis=1).T
        if data.kind is ChannelKind.CONTACT:
            slopes[(held & first)[last]] = 0.0
        return slopes, reading


_EDGES = (0.5, 1.5)  # edges that noise can reach, in steps
_FURTHEST = 8.5  # standard deviations beyond which the effect of noise is below rounding errors
_SMOOTH = 0.5  # noise, in steps, at which the expected reading has no steps left
_SHARP = 1e-9  # least noise in steps, which replaces a smaller one, to avoid division by zero
_PER_SIGMA = 400  # points of the table per standard deviation of the noise
_REACH, _TREAD = 0.2, 0.1  # half width [steps] of the difference quotient, and least slope to avoid zero
_REPEATED = 0.5  # largest share of distinct readings
_SHARES = (0.01, 0.05, 0.2)  # start values of the noise, in steps


class Quantisation(SensorEffect):
    name = "quantisation"
    kind = Kind.SENSOR_STATICS
    physics = "The converter has a finite resolution."
    equation = "reading = mean over the noise of step round((effort + noise)/step)"
    source = "B. Widrow, I. Kollár, Quantization Noise (2008)"
    signature = "readings take few values, and are constant between jumps"
    signals = ("effort",)
    inner = (  # near an edge the noise decides between two readings, between edges it has no effect
        Parameter("step", "{effort}", 1e-15, 1e9, (0.001, 1.0), log=True),
        Parameter("noise", "{effort}", 1e-18, 1e9, (0.0001, 0.1), log=True),
    )
    confused_with = {
        "deadband": "vary the effort slowly over several steps",
        "saturation": "vary the effort slowly over several steps",
    }
    linear = False

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: readings must repeat, else there are no visible steps."""
        return super().applies_to(data) and len(np.unique(data.effort)) < _REPEATED * len(data)

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: the readings change too rarely to test the model.

        A reading between two edges only bounds the effort. A model with as many parameters as there are
        stretches of equal readings can fit all edges, whatever their cause, such as a command's steps.
        """
        changes = (np.diff(data.effort) != 0.0) | (np.diff(data.run) != 0)
        return bool(np.sum(changes) < len(parameters))

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        step = inner["step"]
        first, spacing, cubics = _noise_table(min(max(inner["noise"] / step, _SHARP), _SMOOTH))
        steps = effort / step
        whole = np.round(steps)
        steps -= whole
        place = np.fmax((np.abs(steps) - first) / spacing, 0.0)  # zero for efforts that are not finite
        interval = np.minimum(place.astype(np.int64), cubics.shape[1] - 1)
        place -= interval
        crossed = cubics[0].take(interval)
        for coefficients in cubics[1:]:
            crossed = crossed * place + coefficients.take(interval)
        return np.asarray(step * (whole + np.copysign(crossed, steps)))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: the mean distance between adjacent readings, with several noise levels.

        A single distance is unreliable, since further rounding makes the distances uneven.
        """
        levels = np.unique(data.effort)
        if len(levels) < 2:
            return ({"step": 1.0, "noise": _SHARES[0]},)
        distances = np.diff(levels)
        count = np.sum(np.round(distances / np.median(distances)))
        step = max(float(np.ptp(levels) / max(count, 1.0)), 1e-15)
        return tuple({"step": step, "noise": share * step} for share in _SHARES)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: steep at an edge, nearly zero between edges, and one on average.

        Constant readings between edges give almost no information on the effort; the edges do.
        """
        reach = _REACH * inner["step"]
        ahead, behind = (self.sense(effort + side * reach, data, inner) for side in (1.0, -1.0))
        steepness = _TREAD + (1.0 - _TREAD) * (ahead - behind) / (2.0 * reach)
        return steepness[:, None] * columns


@lru_cache(maxsize=8)
def _noise_table(noise: float) -> tuple[float, float, FloatArray]:
    """Tabulate the mean rounded value of a noisy number, minus the nearest whole number, over their distance.

    Interpolation is ten times faster than the error function, and errs by less than 1e-12 if the noise is
    more than 1e-4 steps.

    Args:
        noise: standard deviation of the noise, in steps.

    Returns:
        First distance, spacing of the table, and coefficients of a cubic in each interval, shape (4, k).
    """
    first = max(0.5 - _FURTHEST * noise, 0.0)
    distance, spacing = np.linspace(first, 0.5, int(_PER_SIGMA * (0.5 - first) / noise) + 4, retstep=True)
    ndtr = scipy.special.ndtr
    crossed = sum(ndtr((distance - edge) / noise) - ndtr((-distance - edge) / noise) for edge in _EDGES)
    spline = scipy.interpolate.CubicSpline(np.arange(len(distance)), crossed)
    return first, float(spacing), np.ascontiguousarray(spline.c)
