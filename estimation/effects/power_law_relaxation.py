"""A nonlinear elastic force that fades without any scale of time."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.signals.viscoelastic import springpot
from robot_io.types import FloatArray

_ALPHAS = (0.08, 0.2, 0.4, 0.7)
_EXPONENTS = (1.0, 1.5, 3.0)


class PowerLawRelaxation(AdditiveEffect):
    """F = k1 integral ((t - s) / 1 s)^-alpha d(x(s)^n): a springpot, between a spring and a dashpot.

    k1 is what it carries one second after a step. Beside `power_law_stiffness` of the same n, the elastic
    force relaxes as a whole (quasi-linear viscoelasticity with a fractional kernel).
    """

    name = "power_law_relaxation"
    physics = "The elastic force flows away on all scales of time alike, as in muscle, cells and gels."
    equation = "F = k1 integral ((t - s)/1 s)^-alpha d(x^n); x only while pressed"
    source = (
        "R. L. Bagley, P. J. Torvik, J. Rheology 27 (1983); B. Fabry et al., Phys. Rev. Lett. 87 (2001): "
        "scale-free relaxation of cells"
    )
    signature = "force in a hold falls by the same share in each decade of time; the peak grows with speed^alpha"
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k1", "{effort}/{position}^n", 0.0, 1e40, (10.0, 1e12)),)
    inner = (
        Parameter("alpha", "1", 0.01, 0.99, (0.1, 0.6)),
        Parameter("n", "1", 0.5, 6.0, (1.0, 4.0)),
    )
    confused_with: ClassVar[dict[str, str]] = {
        "stress_relaxation": "hold for longer: one branch ends, a power law goes on",
        "relaxation_spectrum": "hold a hundred times as long: a power law goes on, branches end",
        "damping": "hold: damping stops with the motion, relaxation goes on",
        "drift": "free air: drift goes on there, relaxation does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 1)."""
        pressed = np.where(data.engaged, data.position, 0.0)
        return springpot(pressed, data.time_s, data.run, inner["n"], inner["alpha"])[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a spring that fades a little to what is nearly a dashpot."""
        return tuple({"alpha": alpha, "n": n} for alpha in _ALPHAS for n in _EXPONENTS)
