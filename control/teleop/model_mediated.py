"""Model-mediated coupling: the operator feels a model of the object that the follower fits by probing.

The first touch of the virtual object requests a probing. Only the target is sent to the follower, which
presses autonomously at several speeds and returns a model of the object. The rendered force comes from that
model without delay, and is passive for any input from the link (`VirtualObject`). Source: Mitra and Niemeyer,
"Model-mediated telemanipulation", IJRR 27(2), 2008; the architecture of the paper's figure 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from math import inf

import numpy as np

from palpate.control.teleop.couplings import (
    DIRECT,
    FOUR_CHANNEL,
    TIME_DOMAIN,
    TRACKING,
    WAVE_VARIABLES,
    Coupling,
    CouplingSide,
    DevicePort,
    Packet,
)
from palpate.control.teleop.virtual_object import ForceLaw, VirtualObject, kelvin_voigt
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

_AXIS = np.array([0.0, 0.0, 1.0])
_TOUCH_N = 0.3
_CLEARANCE_M = 0.005
_RETRACT_M_S = 0.05


@dataclass(frozen=True)
class ObjectModel:
    """Model of an object, which the follower fits and the leader renders."""

    # Function from samples (n, 3) of position [m], velocity [m/s] and compression [N] to parameters.
    fit: Callable[[FloatArray], Packet]
    # Function from parameters to force law and surface position [m].
    law: Callable[[Packet], tuple[ForceLaw, float]]
    guess: Packet  # parameters before the first probing


def _fit_kelvin_voigt(samples: FloatArray) -> Packet:
    """Fit stiffness [N/m], damping [N s/m] and surface [m] of F = k (x - x0) + c v by least squares."""
    position, velocity, force = samples.T
    columns = np.column_stack([position, velocity, np.ones_like(position)])
    (stiffness, damping, offset), *_ = np.linalg.lstsq(columns, force)
    return float(stiffness), float(damping), float(-offset / stiffness)


KELVIN_VOIGT = ObjectModel(
    fit=_fit_kelvin_voigt,
    law=lambda parameters: (kelvin_voigt(parameters[0], parameters[1]), parameters[2]),
    guess=(500.0, 5.0, 0.0),
)


@dataclass(frozen=True)
class ProbingMotion:
    """Speeds and force limit of the follower's presses."""

    speeds_m_s: tuple[float, ...] = (0.06, 0.04, 0.02)
    force_limit_n: float = 8.0

    def __post_init__(self) -> None:
        if not self.speeds_m_s or not all(0.0 < v < inf for v in (*self.speeds_m_s, self.force_limit_n)):
            raise InputError(f"{self}: speeds and force limit must be finite and above 0")


class ModelMediatedLeader(CouplingSide):
    """Leader that renders the model, and requests a probing at its first touch.

    Args:
        model: kind of model.
    """

    def __init__(self, model: ObjectModel) -> None:
        self._law = model.law
        law, surface_m = model.law(model.guess)
        self.virtual = VirtualObject(law, surface_m * _AXIS, -_AXIS)
        self._target = self._answered = 0.0

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if newest is not None and newest[0] > self._answered:
            self._answered = newest[0]
            law, surface_m = self._law(newest[1:])
            self.virtual.update(law, surface_m * _AXIS)
        touch = self.virtual.step(port.position_m * _AXIS, port.velocity_m_s * _AXIS, dt_s)
        if touch.depth_m > 0.0:
            self._target = 1.0
        return -touch.force_n, (self._target,)


class ProbingStage(Enum):
    """Stage of the follower's work."""

    IDLE = "idle"
    PRESS = "press"
    RETRACT = "retract"


@dataclass
class ModelMediatedFollower(CouplingSide):
    """Follower that presses a target at each speed up to the force limit, and returns a model."""

    model: ObjectModel
    motion_plan: ProbingMotion
    stage: ProbingStage = ProbingStage.IDLE
    _answer: Packet = (0.0,)
    _target: float = 0.0
    _presses: int = 0
    _desired_m: float | None = None
    _touched_m: float = 0.0
    _samples: list[DevicePort] = field(default_factory=list)

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if self._desired_m is None:
            self._desired_m = port.position_m
        if newest is not None and newest[0] > self._target:
            self._target, self._presses, self.stage = newest[0], 0, ProbingStage.PRESS
        speed_m_s = self._work(port)
        self._desired_m += speed_m_s * dt_s
        force_n = TRACKING.force_n(self._desired_m - port.position_m, speed_m_s - port.velocity_m_s)
        return force_n, self._answer

    def _work(self, port: DevicePort) -> float:
        """Record samples, change the stage, and return the speed of the reference [m/s]."""
        if port.force_n > _TOUCH_N and self.stage is not ProbingStage.IDLE:
            if not self._samples:
                self._touched_m = port.position_m
            self._samples.append(port)
        if self.stage is ProbingStage.PRESS:
            if port.force_n >= self.motion_plan.force_limit_n:
                self.stage = ProbingStage.RETRACT
            return self.motion_plan.speeds_m_s[self._presses]
        if self.stage is ProbingStage.RETRACT:
            if port.position_m < self._touched_m - _CLEARANCE_M:
                self._presses += 1
                if self._presses < len(self.motion_plan.speeds_m_s):
                    self.stage = ProbingStage.PRESS
                    return -_RETRACT_M_S
                answer = (self._target, *self.model.fit(np.array(self._samples)))
                if np.isfinite(answer).all():  # otherwise the last model stays
                    self._answer = answer
                self._samples.clear()
                self.stage = ProbingStage.IDLE
            return -_RETRACT_M_S
        return 0.0


def model_mediated(model: ObjectModel = KELVIN_VOIGT) -> Coupling:
    """Make the coupling for a kind of object."""
    return Coupling(
        "model-mediated",
        lambda: ModelMediatedLeader(model),
        lambda: ModelMediatedFollower(model, ProbingMotion()),
    )


COUPLINGS = (DIRECT, FOUR_CHANNEL, TIME_DOMAIN, WAVE_VARIABLES, model_mediated())
