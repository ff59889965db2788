"""Interface of estimators of a contact law, which take depth, speed and force."""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

_NO_DEPTH_M = 1e-9  # smallest depth whose powers do not underflow


class ContactLaw(NamedTuple):
    """F = k d^n + b d^m v, d = x - surface; Kelvin-Voigt with n = 1, m = 0, Hunt-Crossley with m = n."""

    stiffness: float  # k [N/m^n], positive
    damping: float  # b [N s/m^(m+1)]
    exponent: float = 1.0  # n
    damping_exponent: float = 0.0  # m
    surface_m: float = 0.0  # where depth begins [m]

    def compliance(self, depth_m: float) -> tuple[float, float]:
        """Return stiffness [N/m] and damping [N s/m] at a depth at rest.

        Args:
            depth_m: indentation at rest, positive into the object [m].
        """
        deep = max(depth_m - self.surface_m, _NO_DEPTH_M)
        stiffness = self.stiffness * self.exponent * deep ** (self.exponent - 1.0)
        return stiffness, self.damping * deep**self.damping_exponent


def check_samples(name: str, *columns: FloatArray) -> None:
    """Reject samples that a method cannot work on.

    Args:
        name: name of the method, for the message.
        columns: samples of equal shape (n,).

    Raises:
        InputError: a sample is not finite, or the numbers of samples differ.
    """
    if len({len(column) for column in columns}) > 1:
        raise InputError(
            f"{name}: {', '.join(str(len(column)) for column in columns)} samples; the numbers must be equal"
        )
    if not all(np.isfinite(column).all() for column in columns):
        raise InputError(f"{name}: some samples are not finite; leave them out")


class ContactEstimator(ABC):
    """Method that estimates a contact law.

    It serves laws that are nonlinear in their parameters, and methods that are more than an estimate of
    gains; `Estimator` is the interface of methods that solve any linear problem.
    """

    name: ClassVar[str]  # as on the command line
    model: ClassVar[str] = "hunt_crossley"  # name of the base model whose law it finds

    @abstractmethod
    def fit(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, *, rng: np.random.Generator
    ) -> ContactLaw:
        """Fit the law to samples in contact, in order of time.

        Args:
            depth_m: indentation, positive into the object, shape (n,) [m].
            speed_m_s: its rate, shape (n,) [m/s].
            force_n: positive in compression, shape (n,) [N].
            rng: random generator for methods that draw samples.

        Raises:
            InputError: the method cannot work on these samples.
        """


class OnlineContactLaw(ContactEstimator):
    """Estimator that takes one sample at a time."""

    @abstractmethod
    def start(self) -> None:
        """Reset to the state before any sample."""

    @abstractmethod
    def update(self, depth_m: float, speed_m_s: float, force_n: float) -> ContactLaw | None:
        """Update the law by one sample in contact.

        Args:
            depth_m: tip beyond where the surface was felt [m].
            speed_m_s: into the object [m/s].
            force_n: positive in compression [N].

        Returns:
            The law after it; None before there is any.
        """

    def fit(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, *, rng: np.random.Generator
    ) -> ContactLaw:
        """See `ContactEstimator.fit`; the last law is the estimate."""
        return self.follow(depth_m, speed_m_s, force_n)[-1]

    def follow(self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray) -> list[ContactLaw]:
        """Return the law after each sample from the first that gives one, from a fresh start.

        Args:
            depth_m: indentation, positive into the object, shape (n,) [m].
            speed_m_s: its rate, shape (n,) [m/s].
            force_n: positive in compression, shape (n,) [N].
        """
        check_samples(self.name, depth_m, speed_m_s, force_n)
        self.start()
        samples = zip(depth_m.tolist(), speed_m_s.tolist(), force_n.tolist(), strict=True)
        laws = [law for sample in samples if (law := self.update(*sample)) is not None]
        if not laws:
            raise InputError(f"{self.name}: none of {len(depth_m)} samples is in contact")
        return laws
