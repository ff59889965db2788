"""Interfaces of estimators: of linear problems, and of contact laws from depth, speed and force."""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from palpate.estimation.estimate import Estimate
from palpate.estimation.fit.irls import Loss
from palpate.estimation.model import Regression
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray


class Estimator(ABC):
    """Method that solves effort = columns @ gains + noise."""

    name: ClassVar[str]  # as on the command line
    # Loss of the preceding search for inner (nonlinear) parameters.
    loss: ClassVar[Loss] = Loss.LINEAR

    @abstractmethod
    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """Estimate the gains from all samples.

        Args:
            regression: the problem; samples of a run in order of time.
            rng: random generator; the same state gives the same estimate.

        Raises:
            InputError: the method cannot use these samples.
        """


class OnlineEstimator(Estimator):
    """An estimator that takes one sample at a time."""

    @abstractmethod
    def start(self, gain_count: int) -> None:
        """Reset the estimator for a given number of columns.

        Args:
            gain_count: number of columns of each row.
        """

    @abstractmethod
    def update(self, row: FloatArray, effort: float) -> FloatArray:
        """Update the gains (p,) by one sample, and return them in a new array.

        Args:
            row: one row of the columns, shape (p,).
            effort: measured effort of this sample.
        """


_MIN_DEPTH_M = 1e-9  # smallest depth whose powers do not underflow


class ContactLaw(NamedTuple):
    """Contact law F = k d^n + b d^m v with depth d = x - surface.

    Kelvin-Voigt has n = 1 and m = 0; Hunt-Crossley has m = n.
    """

    stiffness: float  # k [N/m^n], positive
    damping: float  # b [N s/m^(m+1)]
    exponent: float = 1.0  # n
    damping_exponent: float = 0.0  # m
    surface_m: float = 0.0  # coordinate x of the surface [m]

    def compliance(self, depth_m: float) -> tuple[float, float]:
        """Return stiffness [N/m] and damping [N s/m] at a depth at rest.

        Args:
            depth_m: indentation at rest, positive into the object [m].
        """
        indentation_m = max(depth_m - self.surface_m, _MIN_DEPTH_M)
        stiffness = self.stiffness * self.exponent * indentation_m ** (self.exponent - 1.0)
        return stiffness, self.damping * indentation_m**self.damping_exponent


def check_samples(name: str, *columns: FloatArray) -> None:
    """Check that samples are finite and equal in number.

    Args:
        name: name of the method, for the error message.
        columns: samples of equal shape (n,).

    Raises:
        InputError: a sample is not finite, or the numbers of samples differ.
    """
    if len({len(column) for column in columns}) > 1:
        raise InputError(
            f"{name}: {', '.join(str(len(column)) for column in columns)} samples; give equal numbers"
        )
    if not all(np.isfinite(column).all() for column in columns):
        raise InputError(f"{name}: some samples are not finite; leave them out")


class ContactEstimator(ABC):
    """Method that estimates a contact law.

    Its law may be nonlinear in the parameters. `Estimator` is the interface of methods that solve any linear
    problem.
    """

    name: ClassVar[str]  # as on the command line
    model: ClassVar[str] = "hunt_crossley"  # name of the base model whose law it estimates

    @abstractmethod
    def fit(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, *, rng: np.random.Generator
    ) -> ContactLaw:
        """Fit the law to samples in contact, in order of time.

        Args:
            depth_m: indentation, positive into the object, shape (n,) [m].
            speed_m_s: rate of indentation, shape (n,) [m/s].
            force_n: force, positive in compression, shape (n,) [N].
            rng: random generator for methods that draw samples.

        Raises:
            InputError: the method cannot use these samples.
        """


class OnlineContactLaw(ContactEstimator):
    """Estimator that takes one sample at a time."""

    @abstractmethod
    def start(self) -> None:
        """Reset to the state before any sample."""

    @abstractmethod
    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        """Update the law by one sample in contact; None before the first estimate.

        Args:
            depth_m: distance of the tip beyond the position of the first contact [m].
            speed_m_s: speed, positive into the object [m/s].
            force_n: force, positive in compression [N].
        """

    def fit(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, *, rng: np.random.Generator
    ) -> ContactLaw:
        """See `ContactEstimator.fit`; the last law is the estimate."""
        return self.follow(depth_m, speed_m_s, force_n)[-1]

    def follow(self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray) -> list[ContactLaw]:
        """Reset, process all samples, and return the law after each sample once there is an estimate.

        Args:
            depth_m: indentation, positive into the object, shape (n,) [m].
            speed_m_s: rate of indentation, shape (n,) [m/s].
            force_n: force, positive in compression, shape (n,) [N].

        Raises:
            InputError: no sample gives a law, or a sample is not finite.
        """
        check_samples(self.name, depth_m, speed_m_s, force_n)
        self.start()
        samples = zip(depth_m.tolist(), speed_m_s.tolist(), force_n.tolist(), strict=True)
        laws = [law for sample in samples if (law := self.update(*sample)) is not None]
        if not laws:
            raise InputError(f"{self.name}: none of {len(depth_m)} samples is in contact")
        return laws
