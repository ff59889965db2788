"""Friction that grows with the load on the gear."""

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Inner, Parameter
from estimation.effects.coulomb_friction import CoulombFriction
from estimation.kinds import Kind
from robot_io.types import FloatArray

_LUMPED = "lumped_inertia_effort"  # which a joint has whose rotor and link are one inertia in its model
_SHARES = (1.0, 0.6)


class LoadDependentFriction(CoulombFriction):
    """effort = mu |load| tanh(v / transition), load the effort that the joint carries apart from friction.

    What accelerates the rotor does not pass through the gear (Hamon et al. take it off the load, too). Where
    the model has one inertia for rotor and link, the share of it that is the link's is a parameter.
    """

    name = "load_dependent_friction"
    kind = Kind.FRICTION
    physics = "Gear teeth and bearings rub in proportion to the load they carry."
    equation = "effort = mu |load| tanh(v/transition); of a pendulum, load = weight + link_share J a"
    source = (
        "A. C. Bittencourt, S. Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012); "
        "P. Hamon, M. Gautier, P. Garrec, IEEE/RSJ IROS (2010)"
    )
    signature = "the jump at reversal is larger where the joint carries more"
    signals = ("direction", "load")
    gains = (Parameter("mu", "1", 0.0, 2.0, (0.01, 0.5)),)
    needs = ("load",)
    confused_with = {
        "load_dependent_presliding": "stop under load: presliding friction keeps its last value at rest",
        "coulomb_friction": "repeat with another load",
        "torque_gain": "lift and lower the same load: friction changes sign with the motion, a gain does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return super().columns(data, inner) * np.abs(self._load(data, inner))[:, None]

    def _load(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.asarray(data.context["load"])

    def suited_to(self, data: ChannelData) -> "LoadDependentFriction":
        return _WithRotor() if _LUMPED in data.context else self


class _WithRotor(LoadDependentFriction):
    inner = (*LoadDependentFriction.inner, Parameter("link_share", "1", 0.0, 1.0, (0.3, 1.0)))

    def _load(self, data: ChannelData, inner: Inner) -> FloatArray:
        rotor = (1.0 - inner["link_share"]) * data.context[_LUMPED]
        return np.asarray(data.context["load"] - rotor)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        sliding = super().starts(data)
        return tuple({**start, "link_share": share} for share in _SHARES for start in sliding)
