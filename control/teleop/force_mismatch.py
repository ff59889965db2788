"""Comparison of the follower's measured force with the force of the virtual object."""

from collections import defaultdict, deque
from collections.abc import Hashable
from dataclasses import dataclass
from math import sqrt

_KEPT = 200  # number of samples kept per place
_FEWEST = 8
# A mismatch exceeds this share of the measured force, this multiple of the noise, and this force.
_SHARE = 0.1
_TIMES_NOISE = 3.0
_LEAST_N = 0.1


@dataclass(frozen=True, slots=True)
class ForceMismatch:
    """Difference between model and measurement at one place."""

    place: Hashable  # such as target and phase
    share: (
        float  # mean of measured minus predicted over mean measured force; positive if the model is too soft
    )
    rms_n: float  # root mean square of measured minus predicted [N]

    shallow_m: float  # least and
    deep_m: float  # greatest depth of the samples [m]
    samples: int

    def summary(self) -> str:
        """Write one line for the operator."""
        way = "softer" if self.share > 0.0 else "stiffer"
        return (
            f"from {1e3 * self.shallow_m:.1f} to {1e3 * self.deep_m:.1f} mm depth, the virtual object "
            f"is {100.0 * abs(self.share):.0f} % {way} than the measurement ({self.rms_n:.2f} N rms)"
        )


class MismatchMonitor:
    """Collects pairs of measured and predicted force by place, for one model, without I/O.

    Args:
        noise_n: standard deviation of the follower's force sensor [N].
    """

    def __init__(self, noise_n: float = 0.0) -> None:
        self.noise_n = noise_n
        self._pairs: dict[Hashable, deque[tuple[float, float, float]]] = defaultdict(
            lambda: deque(maxlen=_KEPT)
        )

    def add(self, place: Hashable, depth_m: float, measured_n: float, predicted_n: float) -> None:
        """Add one sample in contact.

        Args:
            place: place, such as target and phase.
            depth_m: depth below the surface [m].
            measured_n: force of the sensor, positive in compression [N].
            predicted_n: force of the model [N].
        """
        self._pairs[place].append((depth_m, measured_n, predicted_n))

    def mismatches(self) -> list[ForceMismatch]:
        """List places where the difference exceeds noise and a tenth of the force, largest first."""
        least_n, off = max(_TIMES_NOISE * self.noise_n, _LEAST_N), []
        for place, pairs in self._pairs.items():
            n, depths_m = len(pairs), [depth for depth, _, _ in pairs]
            rms_n = sqrt(sum((measured - predicted) ** 2 for _, measured, predicted in pairs) / n)
            mean_n = sum(measured - predicted for _, measured, predicted in pairs) / n
            scale_n = max(sqrt(sum(measured**2 for _, measured, _ in pairs) / n), 1e-9)
            if n >= _FEWEST and rms_n / scale_n > _SHARE and rms_n > least_n:
                ends_m = min(depths_m), max(depths_m)
                off.append(ForceMismatch(place, mean_n / scale_n, rms_n, *ends_m, n))
        return sorted(off, key=lambda place: -place.rms_n)
