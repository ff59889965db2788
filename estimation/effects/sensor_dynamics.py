"""Sensor dynamics and drift: delay, lag and a drifting zero."""

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.effect import (
    AdditiveEffect,
    Errors,
    Inner,
    Parameter,
    Parameters,
    SensorEffect,
    start_grid,
)
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.signals.exponential_memory import low_pass
from palpate.estimation.signals.free_air import zero_in_free_air
from palpate.estimation.signals.motion import is_monotonic, is_stepwise_command
from palpate.estimation.signals.runwise import longest_run, sample_time, shift
from palpate.robot_io.types import FloatArray


class Delay(SensorEffect):
    """reading(t) = effort(t - T); T may be a fraction of a sample, as between multiplexed converters.

    |T| is plausible up to half of the longest run. T < 0 (the motion is delayed against the effort) is
    plausible only up to one sample, unless the effort is a command, which acts later; see `is_misnamed`.
    """

    name = "delay"
    kind = Kind.SENSOR_DYNAMICS
    physics = (
        "Conversion, bus and buffers delay every reading by the same time. A negative time means that the "
        "motion follows a command late."
    )
    equation = "reading(t) = effort(t - T)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 3: dead time"
    signature = "readings lag behind the motion with unchanged shape; commands lead it"
    signals = ("past effort",)
    inner = (Parameter("time", "s", -0.5, 2.0, (0.001, 0.1)),)
    confused_with = {
        "lag": "change the effort suddenly: a lag rounds the step, but a delay only shifts it",
        "damping": "hold and probe at two speeds",
        "viscous_friction": "move at two speeds with the same acceleration",
    }
    linear = True

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return shift(effort, data.time_s, data.run, inner["time"])

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: readings lead by over a sample, or are off by half of the longest run.

        With a longer delay, most readings of each run belong to motion before the run began.
        """
        delay_s = parameters[f"{self.name}.time"]
        longest_s = 0.5 * longest_run(data.time_s, data.run)
        lead_s = longest_s if is_stepwise_command(data) else sample_time(data.time_s, data.run)
        return not -lead_s <= delay_s < longest_s

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        step = sample_time(data.time_s, data.run)
        late = np.geomspace(0.25, 150.0, 13)
        early = late if is_stepwise_command(data) else late[late < 1.0]
        return start_grid(time=step * np.array((*-early[::-1], 0.0, *late)))


class Lag(SensorEffect):
    name = "lag"
    kind = Kind.SENSOR_DYNAMICS
    physics = "A filter in the sensor smooths and delays its readings."
    equation = "reading' = (effort - reading)/tau"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 3: first-order instrument"
    signature = "readings lag and are smoothed; the error grows with the rate of the effort"
    signals = ("past effort",)
    inner = (Parameter("tau", "s", 1e-9, 1.0, (0.001, 0.2), log=True),)
    confused_with = {
        "delay": "change the effort suddenly: a lag rounds the step, but a delay only shifts it",
        "damping": "hold and probe at two speeds",
        "inertia": "move at two frequencies",
        "stress_relaxation": "record free air or a moving tip: a lag also acts there",
    }
    linear = True

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.sense`."""
        starts, run = block_index(data.run)
        decay = self.decay(data, inner).reshape(-1, *[1] * (effort.ndim - 1))
        return low_pass(effort, data.time_s, data.run, inner["tau"]) - decay * effort[starts][run]

    def initial_response(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.initial_response`: the first reading of each run decays.

        The effort before a run is unknown if the recording begins in motion.
        """
        starts, run = block_index(data.run)
        return self.decay(data, inner) * data.effort[starts][run]

    def decay(self, data: ChannelData, inner: Inner) -> FloatArray:
        """Return the share (n,) of the reading at the start of each run that is left at each sample.

        Args:
            data: the channel.
            inner: values of the inner parameters by name.
        """
        starts, run = block_index(data.run)
        return np.exp((data.time_s[starts][run] - data.time_s) / inner["tau"])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return start_grid(tau=sample_time(data.time_s, data.run) * np.geomspace(0.2, 400.0, 14))


# Longest time before or after the session at which a drift is zero, relative to the session. Beyond it, more
# than 87 % of the drift's squared effort is that of a constant.
_EARLIER = 0.25
_OFF = 0.5  # largest difference of the rate in free air, relative to the rate
_SIGMAS = 3.0  # largest difference of the rate in standard errors; the larger limit applies


class Drift(AdditiveEffect):
    name = "drift"
    kind = Kind.DRIFT
    physics = "Warm-up or creep of the sensor changes its zero steadily."
    equation = "reading = effort + d (t - t0)"
    source = "JCGM 200:2012 (VIM), 4.21: instrumental drift"
    signature = "readings in free air and in every run drift steadily, whatever the time since contact"
    signals = ("time",)
    one_sided = False
    gains = (
        Parameter("rate", "{effort}/s", -1e12, 1e12, (-0.01, 0.01)),
        Parameter("offset", "{effort}", -1e12, 1e12, (-1.0, 1.0)),
    )
    essential = ("rate",)
    confused_with = {
        "stress_relaxation": "record free air: drift continues there, but relaxation does not",
        "bias": "wait: a bias stays",
    }

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: the motion must return, else time and position are equivalent."""
        return super().applies_to(data) and not is_monotonic(data.position, data.run)

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: the model lacks a bias, or readings in free air drift at another rate.

        A drift is zero at some time of the session; with a larger offset, it is mostly a bias. Beside offsets
        of the runs, its own offset has no meaning.
        """
        rate, offset = (parameters[f"{self.name}.{each}"] for each in ("rate", "offset"))
        elapsed_s = data.time_s - data.time_s[0]
        drift, margin = rate * elapsed_s + offset, _EARLIER * abs(rate) * float(np.ptp(elapsed_s))
        if np.abs(drift).min() > margin and "run_offset.share" not in parameters:
            return True
        zero = zero_in_free_air(data)
        if zero is None or zero.rate is None:
            return False
        return abs(zero.rate - rate) > max(_OFF * abs(rate), _SIGMAS * zero.rate_std_err)

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([data.time_s - data.time_s[0], np.ones(len(data))])
