"""How well Hunt-Crossley is recovered over the range of its parameters (the paper's future work)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from estimation.accuracy.press import Noise, Press
from estimation.contact_estimator import ContactLaw
from estimation.contact_estimators import CONTACT_ESTIMATORS
from robot_io.errors import InputError
from robot_io.types import FloatArray


@dataclass(frozen=True)
class Recovery:
    """One object and how one estimator did on it.

    Attributes:
        law: the truth.
        estimator: its registered name.
        relative: root mean square errors of k, b and n over the truth, shape (3,); NaN if it always failed.
        over_bound: the same over the Cramer-Rao bound, shape (3,).
    """

    law: ContactLaw
    estimator: str
    relative: FloatArray
    over_bound: FloatArray


def recover_hunt_crossley(
    laws: Sequence[ContactLaw], noise: Noise, *, estimators: Sequence[str], draws: int
) -> list[Recovery]:
    """Every law by every contact estimator, on the same `draws` draws of the noise (seeds 0, 1 ...)."""
    found = []
    for law, name in product(laws, estimators):
        press, errors = Press(law), []
        for seed in range(draws):
            rng = np.random.default_rng(seed)
            force_n = press.read(noise, rng)
            try:
                fitted = CONTACT_ESTIMATORS[name]().fit(press.depth_m, press.speed_m_s, force_n, rng=rng)
            except InputError:
                continue
            errors.append(np.array([fitted.stiffness, fitted.damping, fitted.exponent]) - press.truth)
        size = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else np.full(3, np.nan)
        found.append(Recovery(law, name, size / press.truth, size / press.bound(noise)))
    return found
