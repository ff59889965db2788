"""Presses with a known law, their readings, and the Cramer-Rao bound of the law."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.estimator import ContactLaw
from palpate.estimation.model import Regression
from palpate.estimation.statistics.uncertainty import cramer_rao
from palpate.robot_io.types import FloatArray

_TICK_S = 1e-3


@dataclass(frozen=True)
class Noise:
    """Errors of a force reading."""

    floor_n: float = 0.02  # standard deviation that does not depend on the force [N]
    share: float = 0.0  # standard deviation as a share of the force
    outliers: float = 0.0  # share of samples that are outliers
    outlier_n: tuple[float, float] = (-1.0, 4.0)  # range of their errors [N]


@dataclass(frozen=True)
class Press:
    """Pressing in and out with rising frequency, always in contact."""

    law: ContactLaw  # the true law; its surface is at 0
    count: int = 4000  # samples, at 1 kHz
    deepest_m: float = 0.012  # largest depth [m]

    @property
    def time_s(self) -> FloatArray:
        """Times of the samples, shape (n,)."""
        return np.asarray(np.arange(self.count) * _TICK_S)

    @property
    def depth_m(self) -> FloatArray:
        """Depth between a hundredth of the largest and the largest, shape (n,)."""
        return np.asarray(self.deepest_m * (0.01 + 0.495 * (1.0 - np.cos(self._phase))))

    @property
    def speed_m_s(self) -> FloatArray:
        """Speed of the press, positive inwards, shape (n,)."""
        rate = 2.0 * np.pi * (1.5 + 2.0 * self.time_s)
        return np.asarray(0.495 * self.deepest_m * np.sin(self._phase) * rate)

    @property
    def force_n(self) -> FloatArray:
        """Force without noise, shape (n,)."""
        k, b, n, m, _ = self.law
        return np.asarray(k * self.depth_m**n + b * self.depth_m**m * self.speed_m_s)

    @property
    def _phase(self) -> FloatArray:
        return np.asarray(2.0 * np.pi * (1.5 * self.time_s + self.time_s**2))

    def read(self, noise: Noise, rng: np.random.Generator) -> FloatArray:
        """Return measured forces, shape (n,)."""
        force_n = self.force_n + self.sigma_n(noise) * rng.standard_normal(self.count)
        wrong = rng.random(self.count) < noise.outliers
        return np.where(wrong, force_n + rng.uniform(*noise.outlier_n, self.count), force_n)

    def sigma_n(self, noise: Noise) -> FloatArray:
        """Return the standard deviation of each force without outliers, shape (n,) [N]."""
        return np.hypot(noise.floor_n, noise.share * self.force_n)

    @property
    def truth(self) -> FloatArray:
        """Stiffness and damping, and the exponent if damping grows with depth; shape (2,) or (3,)."""
        values = [self.law.stiffness, self.law.damping, self.law.exponent]
        return np.array(values[: 3 if self.law.damping_exponent else 2])

    def bound(self, noise: Noise) -> FloatArray:
        """Return the Cramer-Rao bound of `truth` without outliers, see `cramer_rao`."""
        k, b, n, m, _ = self.law
        slopes = [self.depth_m**n, self.depth_m**m * self.speed_m_s]
        if m:
            slopes.append((k + b * self.speed_m_s) * self.depth_m**n * np.log(self.depth_m))
        return cramer_rao(np.column_stack(slopes), self.sigma_n(noise))

    def regression(self, force_n: FloatArray) -> Regression:
        """Return the linear Kelvin-Voigt regression to these forces (n,)."""
        return Regression(
            np.column_stack([self.depth_m, self.speed_m_s]), force_n, ("k", "c"), ("N/m", "N s/m")
        )
