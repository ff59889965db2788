"""Estimate stiffness, damping and the surface while the arm is probing."""

import math
from collections import deque

import numpy as np

from palpate.control.laws.gains import TouchGains
from palpate.control.laws.touch import RunningMean, release_force_n, touch_force_n
from palpate.control.loop.task import TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates
from palpate.estimation.estimator import ContactLaw, OnlineContactLaw, OnlineEstimator
from palpate.estimation.signals.local_polynomials import fit_weights
from palpate.robot_io.types import Measurement, Status

_GAIN_COUNT = 3
_MIN_SAMPLES = 30  # samples needed to determine three gains
_AIR_SAMPLES = 20  # initial samples that are assumed to be in free air and determine the sensor's zero
_GAP_RATIO = 1.5  # ratio to the previous sample interval above which there is a gap
_DEFAULT_TOUCH = TouchGains()


class LinearKelvinVoigt:
    """Kelvin-Voigt law with an unknown surface, written as a force that is linear in three gains.

        F = k (x - x0) + c v = k x + c v - k x0,    x measured from the position of the first contact

    Args:
        estimator: online estimator of the three gains.
    """

    def __init__(self, estimator: OnlineEstimator) -> None:
        self._estimator = estimator

    def start(self) -> None:
        self._estimator.start(_GAIN_COUNT)

    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        row = np.array([depth_m, speed_m_s, 1.0])
        stiffness, damping, offset_n = self._estimator.update(row, force_n).tolist()
        return ContactLaw(stiffness, damping, surface_m=-offset_n / stiffness) if stiffness > 0.0 else None


class OnlineContactEstimator:
    """Detect contact, compute depth and speed of the tip, and update an estimator with them.

    A force above that in free air counts as contact. The velocity comes from a polynomial fit to the samples
    around each sample. It therefore has no phase error, which would make stiffness look like damping, but
    estimates lag by `half_window` samples. No fit extends across the start of a contact.

    Args:
        estimator: online estimator; a linear one estimates Kelvin-Voigt with an unknown surface.
        touch: thresholds of contact, the same as in the controller (see `palpate.control.laws.gains`).
        half_window: number of samples on each side that are used for a velocity.
    """

    def __init__(
        self,
        estimator: OnlineEstimator | OnlineContactLaw,
        touch: TouchGains = _DEFAULT_TOUCH,
        half_window: int = 5,
    ) -> None:
        self._updater = estimator if isinstance(estimator, OnlineContactLaw) else LinearKelvinVoigt(estimator)
        self._updater.start()
        self._touch_gains = touch
        self._release_n = 0.0
        self._slope: list[float] = fit_weights(2 * half_window + 1, 1)[half_window].tolist()
        self._half = half_window
        self._window: deque[tuple[float, float, float]] = deque(maxlen=2 * half_window + 1)
        self._air = RunningMean()
        self._first_touch_m = math.nan
        self._samples = 0
        self.estimates = NO_ESTIMATE
        self.in_contact = False

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """Return the newest estimates after a tick, NaN before the first; see `tick_record.Observer`."""
        if measurement.force_status is not Status.OK or measurement.encoder_status is not Status.OK:
            return self.estimates
        along_m = float(output.tip_position_world_m.dot(output.press_direction_world))
        return self.update(measurement.force_at_s, along_m, measurement.force_n)

    def update(self, time_s: float, along_m: float, force_n: float) -> Estimates:
        """Process one sample, and return the newest estimates.

        Args:
            time_s: time of the sample [s].
            along_m: position of the tip along the press direction [m].
            force_n: force, positive in compression [N].
        """
        net_force_n = force_n - self._air.mean
        if self.in_contact:
            self._update_in_contact(time_s, along_m, net_force_n)
        elif self._air.count >= _AIR_SAMPLES and net_force_n > (
            touch_n := touch_force_n(self._air.standard_deviation, self._touch_gains.touch_force_n)
        ):
            # The first sample is excluded: it was selected by its force, which biases it.
            self.in_contact = True
            self._release_n = release_force_n(touch_n, self._touch_gains)
            self._window.clear()
            if math.isnan(self._first_touch_m):
                self._first_touch_m = along_m
        else:
            self._air.add(force_n)
        return self.estimates

    def _update_in_contact(self, time_s: float, along_m: float, net_force_n: float) -> None:
        if net_force_n < self._release_n:
            self.in_contact = False
            return
        window = self._window
        if len(window) > 1 and time_s - window[-1][0] > _GAP_RATIO * (window[-1][0] - window[-2][0]):
            window.clear()
        window.append((time_s, along_m - self._first_touch_m, net_force_n))
        if len(window) < 2 * self._half + 1:
            return
        step_s = (window[-1][0] - window[0][0]) / (len(window) - 1)
        _, depth_m, force_n = window[self._half]
        slope_m = sum([slope * depth_m for slope, (_, depth_m, _) in zip(self._slope, window, strict=True)])
        law = self._updater.update(depth_m, slope_m / step_s, force_n)
        self._samples += 1
        if self._samples >= _MIN_SAMPLES and law is not None:
            self.estimates = (*law.compliance(depth_m), self._first_touch_m + law.surface_m)
