"""Comparison of the follower's measured force with the force of the virtual object."""

from collections import defaultdict, deque
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

_KEPT = 200  # number of samples kept per place
_FEWEST = 8  # smallest number of samples that show a mismatch
# A mismatch exceeds this share of the measured force, this multiple of the noise, and this force.
_SHARE = 0.1
_TIMES_NOISE = 3.0
_LEAST_N = 0.1


@dataclass(frozen=True, slots=True)
class ForceMismatch:
    """Difference between model and measurement at one place."""

    place: Hashable  # such as target and phase
    # Mean of measured minus predicted, over the root mean square of the measured force; positive if the model
    # is too soft.
    share: float
    rms_n: float  # root mean square of measured minus predicted [N]
    least_depth_m: float  # smallest depth of the samples [m]
    most_depth_m: float  # largest depth of the samples [m]
    samples: int  # number of samples

    def summary(self) -> str:
        """Write one line for the operator."""
        way = "softer" if self.share > 0.0 else "stiffer"
        depths = f"{1e3 * self.least_depth_m:.1f} to {1e3 * self.most_depth_m:.1f} mm"
        return (
            f"at depths of {depths}, the virtual object is {100.0 * abs(self.share):.0f} % {way} than the "
            f"measured one (difference {self.rms_n:.2f} N rms)"
        )


class MismatchMonitor:
    """Collects pairs of measured and predicted force by place, for one model, without I/O.

    Args:
        noise_n: standard deviation of the follower's force sensor [N].
    """

    def __init__(self, noise_n: float = 0.0) -> None:
        self.noise_n = noise_n
        # Depth [m], measured and predicted force [N] by place.
        self._samples = defaultdict[Hashable, deque[tuple[float, float, float]]](lambda: deque(maxlen=_KEPT))

    def add(self, place: Hashable, depth_m: float, measured_n: float, predicted_n: float) -> None:
        """Add one sample in contact.

        Args:
            place: place, such as target and phase.
            depth_m: depth below the surface [m].
            measured_n: force of the sensor, positive in compression [N].
            predicted_n: force of the model [N].
        """
        self._samples[place].append((depth_m, measured_n, predicted_n))

    def mismatches(self) -> list[ForceMismatch]:
        """List places where the difference exceeds noise and a tenth of the force, largest first."""
        least_n, mismatches = max(_TIMES_NOISE * self.noise_n, _LEAST_N), []
        for place, samples in self._samples.items():
            depths_m, measured_n, predicted_n = np.array(samples).T
            errors_n = measured_n - predicted_n
            rms_n, scale_n = (float(np.sqrt(np.mean(force_n**2))) for force_n in (errors_n, measured_n))
            scale_n = max(scale_n, 1e-9)
            if len(samples) >= _FEWEST and rms_n / scale_n > _SHARE and rms_n > least_n:
                ends_m = float(depths_m.min()), float(depths_m.max())
                share = float(errors_n.mean()) / scale_n
                mismatches.append(ForceMismatch(place, share, rms_n, *ends_m, len(samples)))
        return sorted(mismatches, key=lambda mismatch: -mismatch.rms_n)
