"""Five couplings of a leader and a follower on one axis, over a link that delays and loses packets.

They were compared to choose the coupling of `palpate teleop`, see docs/explanation/couplings.md. Positions
are positive into the object. A coupling has two sides that exchange small packets; each side is stepped on
its own machine. Three axes need three couplings. The module has no clock and opens no link. In each step a
channel gives a side one packet: the newest received one, repeated until a newer one arrives, or each packet
after a constant delay. Lost, late and repeated packets therefore all look like old packets.

- Direct (position-force): the follower tracks the leader's position, and the measured force is fed back.
- Four channels: position, velocity and force travel both ways. Lawrence, "Stability and transparency in
  bilateral teleoperation", IEEE T-RA 9(5), 1993.
- Time-domain passivity: each side observes the energy of the link, and releases no more than was put in.
  Hannaford and Ryu, "Time-domain passivity control of haptic interfaces", IEEE T-RA 18(1), 2002. Because of
  the delay, no side knows the energy at both ends. Each side therefore sends the energy that it has put in,
  and releases at most what the other has reported: Ryu, Artigas and Preusche, "A passive bilateral control
  scheme for a teleoperator with time-varying communication delay", Mechatronics 20(7), 2010. A spring joins
  each device to a point at the end of the link, and the controllers limit the motion of this point; so the
  energy of a step is known before the step (the leader's spring is our addition). In free air no force comes
  back, so the follower would receive no energy to move with. The leader therefore feels a drag, whose energy
  goes to the link as into the tank of Lee and Huang, IEEE T-RO 26(2), 2010.
- Wave variables: velocity and force travel as two waves, and a delayed wave carries no more energy than it
  had, u = (b v + F) / sqrt(2 b), w = (b v - F) / sqrt(2 b), F v = u^2 / 2 - w^2 / 2. Niemeyer and Slotine,
  "Stable adaptive teleoperation", IEEE J. Oceanic Eng. 16(1), 1991. Integrals of the waves prevent drift:
  "Telemanipulation with time delays", IJRR 23(9), 2004. Repeating a wave when nothing newer arrives would
  produce energy (Berestesky, Chopra and Spong, ICRA 2004). Each packet therefore states the energy sent so
  far, and no side releases more.
- Model-mediated: the first touch of the virtual object requests a probing. Only the target is sent to the
  follower, which presses autonomously at several speeds and returns a model of the object. The rendered force
  comes from that model without delay, and is passive for any input from the link (`VirtualObject`). Mitra and
  Niemeyer, "Model-mediated telemanipulation", IJRR 27(2), 2008; the architecture of the paper's figure 1.
"""

import heapq
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np

from palpate.control.teleop.virtual_object import ForceLaw, VirtualObject
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, clip

Packet = tuple[float, ...]  # what one side sends the other in a step
_MAX_AGE_STEPS = 10_000  # largest age behind the newest packet, in steps; older packets are ignored


class PacketChannel(ABC):
    """One side's end of the link, without I/O: `take` received packets, then call `packet` once per step."""

    def take(self, number: int, packet: Packet) -> None:
        """Store a received packet.

        Args:
            number: step of the sender in which it was sent.
            packet: ignored if a value is not finite.
        """
        if math.isfinite(sum(packet)):
            self._store(number, packet)

    @abstractmethod
    def _store(self, number: int, packet: Packet) -> None:
        """Store a finite packet."""

    @abstractmethod
    def packet(self) -> Packet | None:
        """Return the packet of this step; None before the first. Call it once per step."""


class LatestPacketChannel(PacketChannel):
    """Channel that returns the newest packet; an overtaken packet is dropped."""

    def __init__(self) -> None:
        self._number = -1
        self._packet: Packet | None = None

    def _store(self, number: int, packet: Packet) -> None:
        if number > self._number:
            self._number, self._packet = number, packet

    def packet(self) -> Packet | None:
        """See `PacketChannel.packet`."""
        return self._packet


class PlayoutBuffer(PacketChannel):
    """Playout buffer that delays each packet to the largest delay so far.

    So jitter becomes a constant delay, as wave variables require (Kosuge, Murayama and Takeo, "Bilateral
    feedback control of telemanipulators via computer network", IROS 1996). A lost packet is replaced by the
    one before it.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, Packet]] = []
        self._step = self._played = self._newest = -1
        self._delay_steps = -math.inf  # from sending to arrival, in steps counted from different starts
        self._packet: Packet | None = None

    def _store(self, number: int, packet: Packet) -> None:
        if number <= self._played or number < self._newest - _MAX_AGE_STEPS:
            return
        self._newest = max(self._newest, number)
        self._delay_steps = max(self._delay_steps, self._step + 1 - number)
        heapq.heappush(self._waiting, (number, packet))

    def packet(self) -> Packet | None:
        """See `PacketChannel.packet`."""
        self._step += 1
        while self._waiting and self._waiting[0][0] + self._delay_steps <= self._step:
            self._played, self._packet = heapq.heappop(self._waiting)
        return self._packet


class DevicePort(NamedTuple):
    """State of a side's own device."""

    position_m: float  # position of the device's tip along the axis [m]
    velocity_m_s: float  # [m/s]
    # Leader: force of the hand on the device, positive inwards. Follower: compression of its tool [N].
    force_n: float


class CouplingSide(ABC):
    """Leader or follower of a coupling; a new one implements `_step`."""

    def step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        """Compute one step of the control loop.

        Args:
            port: state of the own device.
            newest: packet of the other side from the channel; None before the first.
            dt_s: time until the next step, for which the force is held [s].

        Returns:
            Force of the actuator on the own device [N], positive inwards, and the packet for the other side.

        Raises:
            InputError: a value is not finite, or the time is not positive; the state is unchanged.
        """
        if not math.isfinite(sum(port) + sum(newest or ())) or not 0.0 < dt_s < math.inf:
            raise InputError(f"coupling: {port}, packet {newest}, step {dt_s} s: all must be finite numbers")
        return self._step(port, newest, dt_s)

    @abstractmethod
    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        """See `step`; the values are finite."""


@dataclass(frozen=True)
class Coupling:
    """A coupling by name, with constructors of its two sides."""

    name: str
    leader: Callable[[], CouplingSide]
    follower: Callable[[], CouplingSide]
    channel: Callable[[], PacketChannel] = LatestPacketChannel  # one for each side


@dataclass(frozen=True)
class PositionTracking:
    """The follower's position control, common to all couplings: F = K (x_des - x) + B (v_des - v)."""

    stiffness_n_m: float = 8000.0
    damping_n_s_m: float = 120.0

    def __post_init__(self) -> None:
        for value in (self.stiffness_n_m, self.damping_n_s_m):
            if not 0.0 <= value < math.inf:
                raise InputError(
                    f"tracking: stiffness and damping must be finite and not negative (are {value})"
                )

    def force_n(self, position_error_m: float, velocity_error_m_s: float) -> float:
        """Compute the tracking force [N].

        Args:
            position_error_m: desired minus actual position [m].
            velocity_error_m_s: desired minus actual velocity [m/s].
        """
        return self.stiffness_n_m * position_error_m + self.damping_n_s_m * velocity_error_m_s


TRACKING = PositionTracking()


class DirectLeader(CouplingSide):
    """Leader that sends position and velocity, and renders the received force."""

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        return -newest[0] if newest else 0.0, (port.position_m, port.velocity_m_s)


class DirectFollower(CouplingSide):
    """Follower that tracks the received position and velocity, and sends the measured force."""

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        desired_m, desired_m_s = newest or (port.position_m, 0.0)
        force_n = TRACKING.force_n(desired_m - port.position_m, desired_m_s - port.velocity_m_s)
        return force_n, (port.force_n,)


DIRECT = Coupling("direct", DirectLeader, DirectFollower)


class FourChannelSide(CouplingSide):
    """Side that tracks the other side, and adds its measured force; `reflects` if that is a compression."""

    def __init__(self, *, reflects: bool) -> None:
        self._sign = -1.0 if reflects else 1.0

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        other_m, other_m_s, other_n = newest or (port.position_m, port.velocity_m_s, 0.0)
        tracking_n = TRACKING.force_n(other_m - port.position_m, other_m_s - port.velocity_m_s)
        return tracking_n + self._sign * other_n, tuple(port)


FOUR_CHANNEL = Coupling(
    "four-channel", lambda: FourChannelSide(reflects=True), lambda: FourChannelSide(reflects=False)
)


DRAG_N_S_M = 10.0
RESERVE_J = 1e-3  # energy that each end may initially take, before any is put in
_MAX_SPEED_M_S = 0.5  # largest speed of a point of the link, mainly after a gap in the packets


class PassivityObserver:
    """Energy balance of one end of the link, as known there [J]."""

    def __init__(self) -> None:
        self.input_j = 0.0  # by this end
        self._output_j = 0.0

    def add_work(self, work_j: float) -> None:
        """Add the work that this end did on the link in a step; negative if the link did work on this end.

        Args:
            work_j: positive if this end worked on the link [J].
        """
        if work_j > 0.0:
            self.input_j += work_j
        else:
            self._output_j -= work_j

    def allowed_share(self, output_j: float, other_input_j: float) -> float:
        """Return the share, 0 to 1, of a withdrawal that is covered by the other end's known input.

        Args:
            output_j: energy to be taken out [J].
            other_input_j: energy put in by the other end, as known here [J].
        """
        available_j = max(0.0, RESERVE_J + other_input_j - self._output_j)
        return 1.0 if output_j <= available_j else available_j / output_j


class TimeDomainLeader(CouplingSide):
    """Leader whose virtual spring renders the received force, as far as the energy balance allows it."""

    def __init__(self) -> None:
        self._observer = PassivityObserver()
        self._point_m = self._position_m = math.nan
        self._drag_n = 0.0

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if math.isnan(self._point_m):
            self._point_m = self._position_m = port.position_m
        force_n, other_input_j = newest or (0.0, 0.0)
        stiffness = TRACKING.stiffness_n_m
        stretch_m = port.position_m - self._point_m
        step_m = clip(stretch_m - force_n / stiffness, -_MAX_SPEED_M_S * dt_s, _MAX_SPEED_M_S * dt_s)
        step_m *= self._observer.allowed_share(-stiffness * (stretch_m - step_m) * step_m, other_input_j)
        spring_n = stiffness * (stretch_m - step_m)  # after the step: understates input, overstates output
        self._observer.add_work(spring_n * step_m)
        self._observer.add_work(self._drag_n * (port.position_m - self._position_m))
        self._point_m += step_m
        self._position_m, self._drag_n = port.position_m, DRAG_N_S_M * port.velocity_m_s
        return -spring_n - self._drag_n, (port.position_m, self._observer.input_j)


class TimeDomainFollower(CouplingSide):
    """Follower that moves its point to the leader's position, as far as the energy balance allows it.

    It sends the tracking force. A motion that was held back is made up for as soon as the balance allows it,
    so positions do not drift apart.
    """

    def __init__(self) -> None:
        self._observer = PassivityObserver()
        self._desired_m = math.nan

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if math.isnan(self._desired_m):
            self._desired_m = port.position_m
        goal_m, other_input_j = newest or (self._desired_m, 0.0)
        step_m = clip(goal_m - self._desired_m, -_MAX_SPEED_M_S * dt_s, _MAX_SPEED_M_S * dt_s)
        step_m *= self._observer.allowed_share(self._force_n(port, step_m, dt_s) * step_m, other_input_j)
        force_n = self._force_n(port, step_m, dt_s)  # smaller by more than the share, if that is below 1
        self._observer.add_work(-force_n * step_m)
        self._desired_m += step_m
        return force_n, (force_n, self._observer.input_j)

    def _force_n(self, port: DevicePort, step_m: float, dt_s: float) -> float:
        """Return the tracking force [N] after the desired position has moved by `step_m` [m]."""
        return TRACKING.force_n(self._desired_m + step_m - port.position_m, step_m / dt_s - port.velocity_m_s)


TIME_DOMAIN = Coupling("time-domain passivity", TimeDomainLeader, TimeDomainFollower)


IMPEDANCE_N_S_M = 30.0  # b: felt as drag in free air, and over a delay T as a spring b / T in contact
_CATCH_UP_1_S = 5.0  # rate at which the integrals are matched
_GAP_STEPS = 5.0  # energy is kept back to hold the wave for so long, before any is spent on catching up


class WavePort:
    """One end of the wave lines: counts sent energy, and returns at most the received energy."""

    def __init__(self) -> None:
        self._sent = self._sent_j = self._used = self._used_j = 0.0

    def send(self, wave: float, dt_s: float) -> Packet:
        """Return the packet for a wave [sqrt(W)]: the wave, its integral, and the energy sent so far [J].

        Args:
            wave: outgoing wave [sqrt(W)].
            dt_s: step [s].
        """
        self._sent += wave * dt_s
        self._sent_j += 0.5 * wave * wave * dt_s
        return wave, self._sent, self._sent_j

    def receive(self, newest: Packet | None, dt_s: float) -> float:
        """Return the wave to use in this step [sqrt(W)].

        Args:
            newest: packet of the other end, or None.
            dt_s: step [s].
        """
        if newest is None:
            return 0.0
        wave, sent, sent_j = newest
        available_j = max(0.0, sent_j - self._used_j)
        if available_j > _GAP_STEPS * 0.5 * wave * wave * dt_s:
            wave += _CATCH_UP_1_S * (sent - self._used)
        wave_limit = math.sqrt(2.0 * available_j / dt_s)
        wave = math.copysign(min(abs(wave), wave_limit), wave)
        self._used += wave * dt_s
        self._used_j += 0.5 * wave * wave * dt_s
        return wave


class WaveLeader(CouplingSide):
    """Leader that computes a force and the outgoing wave from its velocity and the incoming wave."""

    def __init__(self) -> None:
        self._end = WavePort()
        self._root = math.sqrt(2.0 * IMPEDANCE_N_S_M)

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        back = self._end.receive(newest, dt_s)
        force_n = IMPEDANCE_N_S_M * port.velocity_m_s - self._root * back
        return -force_n, self._end.send(self._root * port.velocity_m_s - back, dt_s)


class WaveFollower(CouplingSide):
    """Follower that computes a desired velocity from the incoming wave, and the outgoing wave from its force.

    Desired velocity and force depend on each other. They are solved for the end of the step (implicitly), so
    that the spring of the tracking generates no energy.
    """

    def __init__(self) -> None:
        self._end = WavePort()
        self._root = math.sqrt(2.0 * IMPEDANCE_N_S_M)
        self._desired_m = math.nan

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        wave = self._end.receive(newest, dt_s)
        position_error_m = 0.0 if math.isnan(self._desired_m) else self._desired_m - port.position_m
        yielding_n_s_m = IMPEDANCE_N_S_M + TRACKING.stiffness_n_m * dt_s
        free_m_s = self._root * wave / IMPEDANCE_N_S_M  # desired velocity without force
        force_n = (
            TRACKING.stiffness_n_m * position_error_m + yielding_n_s_m * (free_m_s - port.velocity_m_s)
        ) / (1.0 + yielding_n_s_m / IMPEDANCE_N_S_M)
        desired_m_s = free_m_s - force_n / IMPEDANCE_N_S_M
        self._desired_m = port.position_m + position_error_m + desired_m_s * dt_s
        return force_n, self._end.send(wave - self._root * force_n / IMPEDANCE_N_S_M, dt_s)


WAVE_VARIABLES = Coupling("wave variables", WaveLeader, WaveFollower, PlayoutBuffer)


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


def _kelvin_voigt(parameters: Packet) -> tuple[ForceLaw, float]:
    """Make the law F = k x + c dx/dt, clipped at zero, and its surface [m]."""
    stiffness_n_m, damping_n_s_m, surface_m = parameters

    def force_n(depth_m: float, rate_m_s: float, _dt_s: float) -> float:
        return max(0.0, stiffness_n_m * depth_m + damping_n_s_m * rate_m_s) if depth_m > 0.0 else 0.0

    return force_n, surface_m


KELVIN_VOIGT = ObjectModel(
    fit=_fit_kelvin_voigt,
    law=_kelvin_voigt,
    guess=(500.0, 5.0, 0.0),
)


@dataclass(frozen=True)
class ProbingMotion:
    """Speeds and force limit of the follower's presses."""

    speeds_m_s: tuple[float, ...] = (0.06, 0.04, 0.02)
    force_limit_n: float = 8.0

    def __post_init__(self) -> None:
        if not self.speeds_m_s or not all(0.0 < v < math.inf for v in (*self.speeds_m_s, self.force_limit_n)):
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
