"""Five couplings of a leader and a follower on one simulated axis, over a link that delays and loses packets.

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

In the simulation (`run`) a hand holds the leader's device, the follower's arm meets an object, and a link
delays, jitters and loses packets each way. Device, arm and object share no code with what renders forces.
"""

import heapq
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from palpate.control.teleop.virtual_object import ForceLaw, VirtualObject
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, clip

Packet = tuple[float, ...]  # what one side sends the other in a step
_MAX_AGE_STEPS = 10_000  # largest age behind the newest packet, in steps; older packets are ignored


class LatestPacketChannel:
    """One side's end of the link, which returns the newest packet; an overtaken packet is dropped."""

    def __init__(self) -> None:
        self._newest = -1
        self._packet: Packet | None = None

    def take(self, number: int, packet: Packet) -> None:
        """Store a received packet, sent in step `number` of the sender; ignore one that is not finite."""
        if math.isfinite(sum(packet)):
            self._store(number, packet)

    def _store(self, number: int, packet: Packet) -> None:
        if number > self._newest:
            self._newest, self._packet = number, packet

    def packet(self) -> Packet | None:
        """Return the packet of this step; None before the first. Call it once per step."""
        return self._packet


class PlayoutBuffer(LatestPacketChannel):
    """Channel that delays each packet to the largest delay so far.

    So jitter becomes a constant delay, as wave variables require (Kosuge, Murayama and Takeo, "Bilateral
    feedback control of telemanipulators via computer network", IROS 1996). A lost packet is replaced by the
    one before it.
    """

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[tuple[int, Packet]] = []
        self._step = self._played = -1
        self._delay_steps = -math.inf  # from sending to arrival, in steps counted from different starts

    def _store(self, number: int, packet: Packet) -> None:
        if number <= self._played or number < self._newest - _MAX_AGE_STEPS:
            return
        self._newest = max(self._newest, number)
        self._delay_steps = max(self._delay_steps, self._step + 1 - number)
        heapq.heappush(self._waiting, (number, packet))

    def packet(self) -> Packet | None:
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
    channel: Callable[[], LatestPacketChannel] = LatestPacketChannel  # one for each side


STIFFNESS_N_M, DAMPING_N_S_M = 8000.0, 120.0  # of the follower's position control, common to all couplings


def tracking_n(error_m: float, error_m_s: float) -> float:
    """Compute the tracking force from desired minus actual position [m] and velocity [m/s]."""
    return STIFFNESS_N_M * error_m + DAMPING_N_S_M * error_m_s


class DirectLeader(CouplingSide):
    """Leader that sends position and velocity, and renders the received force."""

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        return -newest[0] if newest else 0.0, (port.position_m, port.velocity_m_s)


class DirectFollower(CouplingSide):
    """Follower that tracks the received position and velocity, and sends the measured force."""

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        desired_m, desired_m_s = newest or (port.position_m, 0.0)
        force_n = tracking_n(desired_m - port.position_m, desired_m_s - port.velocity_m_s)
        return force_n, (port.force_n,)


DIRECT = Coupling("direct", DirectLeader, DirectFollower)


class FourChannelSide(CouplingSide):
    """Side that tracks the other side, and adds its measured force; `reflects` if that is a compression."""

    def __init__(self, *, reflects: bool) -> None:
        self._sign = -1.0 if reflects else 1.0

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        other_m, other_m_s, other_n = newest or (port.position_m, port.velocity_m_s, 0.0)
        force_n = tracking_n(other_m - port.position_m, other_m_s - port.velocity_m_s)
        return force_n + self._sign * other_n, tuple(port)


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
        """Add the work of this end on the link in a step; negative if the link did work on this end [J]."""
        if work_j > 0.0:
            self.input_j += work_j
        else:
            self._output_j -= work_j

    def allowed_share(self, output_j: float, other_input_j: float) -> float:
        """Return the share, 0 to 1, of a withdrawal [J] that the other end's known input [J] covers."""
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
        stiffness = STIFFNESS_N_M
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
        return tracking_n(self._desired_m + step_m - port.position_m, step_m / dt_s - port.velocity_m_s)


TIME_DOMAIN = Coupling("time-domain passivity", TimeDomainLeader, TimeDomainFollower)


IMPEDANCE_N_S_M = 30.0  # b: felt as drag in free air, and over a delay T as a spring b / T in contact
_CATCH_UP_1_S = 5.0  # rate at which the integrals are matched
_GAP_STEPS = 5.0  # energy is kept back to hold the wave for so long, before any is spent on catching up


class WavePort:
    """One end of the wave lines: counts sent energy, and returns at most the received energy."""

    def __init__(self) -> None:
        self._sent = self._sent_j = self._used = self._used_j = 0.0

    def send(self, wave: float, dt_s: float) -> Packet:
        """Return the packet for a wave [sqrt(W)]: the wave, its integral, and the energy sent so far [J]."""
        self._sent += wave * dt_s
        self._sent_j += 0.5 * wave * wave * dt_s
        return wave, self._sent, self._sent_j

    def receive(self, newest: Packet | None, dt_s: float) -> float:
        """Return the wave to use in this step [sqrt(W)], from the newest packet of the other end."""
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
        yielding_n_s_m = IMPEDANCE_N_S_M + STIFFNESS_N_M * dt_s
        free_m_s = self._root * wave / IMPEDANCE_N_S_M  # desired velocity without force
        force_n = (STIFFNESS_N_M * position_error_m + yielding_n_s_m * (free_m_s - port.velocity_m_s)) / (
            1.0 + yielding_n_s_m / IMPEDANCE_N_S_M
        )
        desired_m_s = free_m_s - force_n / IMPEDANCE_N_S_M
        self._desired_m = port.position_m + position_error_m + desired_m_s * dt_s
        return force_n, self._end.send(wave - self._root * force_n / IMPEDANCE_N_S_M, dt_s)


WAVE_VARIABLES = Coupling("wave variables", WaveLeader, WaveFollower, PlayoutBuffer)


_AXIS = np.array([0.0, 0.0, 1.0])
_TOUCH_N = 0.3
_CLEARANCE_M = 0.005
_RETRACT_M_S = 0.05


_SPEEDS_M_S, _FORCE_LIMIT_N = (0.06, 0.04, 0.02), 8.0  # of the follower's presses
_GUESS = (500.0, 5.0, 0.0)  # stiffness [N/m], damping [N s/m] and surface [m] before the first probing


def _fit(samples: FloatArray) -> Packet:
    """Fit F = k (x - x0) + c v to samples (n, 3) of position [m], velocity [m/s] and compression [N]."""
    position, velocity, force = samples.T
    columns = np.column_stack([position, velocity, np.ones_like(position)])
    (stiffness, damping, offset), *_ = np.linalg.lstsq(columns, force)
    return float(stiffness), float(damping), float(-offset / stiffness)


def _law(parameters: Packet) -> tuple[ForceLaw, FloatArray]:
    """Make the law F = k x + c dx/dt, clipped at zero, and a point of its surface, shape (3,) [m]."""
    stiffness_n_m, damping_n_s_m, surface_m = parameters

    def force_n(depth_m: float, rate_m_s: float, _dt_s: float) -> float:
        return max(0.0, stiffness_n_m * depth_m + damping_n_s_m * rate_m_s) if depth_m > 0.0 else 0.0

    return force_n, surface_m * _AXIS


class ModelMediatedLeader(CouplingSide):
    """Leader that renders the model, and requests a probing at its first touch."""

    def __init__(self) -> None:
        self.virtual = VirtualObject(*_law(_GUESS), -_AXIS)
        self._target = self._answered = 0.0

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if newest is not None and newest[0] > self._answered:
            self._answered = newest[0]
            self.virtual.update(*_law(newest[1:]))
        touch = self.virtual.step(port.position_m * _AXIS, port.velocity_m_s * _AXIS, dt_s)
        if touch.depth_m > 0.0:
            self._target = 1.0
        return -touch.force_n, (self._target,)


class ProbingStage(Enum):
    """Stage of the follower's work."""

    IDLE = "idle"
    PRESS = "press"
    RETRACT = "retract"


class ModelMediatedFollower(CouplingSide):
    """Follower that presses a target at each speed up to the force limit, and returns a model."""

    def __init__(self) -> None:
        self.stage = ProbingStage.IDLE
        self._answer: Packet = (0.0,)
        self._target, self._presses, self._touched_m = 0.0, 0, 0.0
        self._desired_m: float | None = None
        self._samples: list[DevicePort] = []

    def _step(self, port: DevicePort, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if self._desired_m is None:
            self._desired_m = port.position_m
        if newest is not None and newest[0] > self._target:
            self._target, self._presses, self.stage = newest[0], 0, ProbingStage.PRESS
        speed_m_s = self._work(port)
        self._desired_m += speed_m_s * dt_s
        force_n = tracking_n(self._desired_m - port.position_m, speed_m_s - port.velocity_m_s)
        return force_n, self._answer

    def _work(self, port: DevicePort) -> float:
        """Record samples, change the stage, and return the speed of the reference [m/s]."""
        if port.force_n > _TOUCH_N and self.stage is not ProbingStage.IDLE:
            if not self._samples:
                self._touched_m = port.position_m
            self._samples.append(port)
        if self.stage is ProbingStage.PRESS:
            if port.force_n >= _FORCE_LIMIT_N:
                self.stage = ProbingStage.RETRACT
            return _SPEEDS_M_S[self._presses]
        if self.stage is ProbingStage.RETRACT:
            if port.position_m < self._touched_m - _CLEARANCE_M:
                self._presses += 1
                if self._presses < len(_SPEEDS_M_S):
                    self.stage = ProbingStage.PRESS
                    return -_RETRACT_M_S
                answer = (self._target, *_fit(np.array(self._samples)))
                if np.isfinite(answer).all():  # otherwise the last model stays
                    self._answer = answer
                self._samples.clear()
                self.stage = ProbingStage.IDLE
            return -_RETRACT_M_S
        return 0.0


MODEL_MEDIATED = Coupling("model-mediated", ModelMediatedLeader, ModelMediatedFollower)
COUPLINGS = (DIRECT, FOUR_CHANNEL, TIME_DOMAIN, WAVE_VARIABLES, MODEL_MEDIATED)


T = TypeVar("T")
_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class LinkFaults:
    """What the link does to packets, each way."""

    delay_s: float = 0.0
    jitter_s: float = 0.0  # largest additional delay, uniformly distributed; packets may overtake each other
    loss: float = 0.0  # share of packets that never come, independently

    def __str__(self) -> str:
        return f"{1e3 * self.delay_s:.0f} ms + {1e3 * self.jitter_s:.0f} ms, {100 * self.loss:.0f} %"


class DelayLine(Generic[T]):
    """One direction of the link, for packets of any kind."""

    def __init__(self, faults: LinkFaults, rng: np.random.Generator) -> None:
        self._faults, self._rng = faults, rng
        self._under_way: list[tuple[float, int, T]] = []
        self._number = -1

    def send(self, packet: T, time_s: float) -> None:
        """Put a packet on the way at `time_s` [s]."""
        self._number += 1
        late, lost = self._rng.random(2)
        if lost >= self._faults.loss:
            arrives_s = time_s + self._faults.delay_s + late * self._faults.jitter_s
            heapq.heappush(self._under_way, (arrives_s, self._number, packet))

    @property
    def next_s(self) -> float:
        """Time of the next arrival [s]; infinite if no packet is under way."""
        return self._under_way[0][0] if self._under_way else float("inf")

    def arrived(self, time_s: float) -> list[tuple[int, T]]:
        """Packets that have arrived by `time_s` [s] since the last call, each with its number."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= time_s + _ROUNDING_S:
            arrived.append(heapq.heappop(self._under_way)[1:])
        return arrived


DT_S = 1e-3
SUBSTEP_S = 0.25e-3
SUBSTEPS = round(DT_S / SUBSTEP_S)
DEVICE_LIMIT_N = 60.0  # of both devices' motors
WALL_M = 0.25  # neither device goes further
START_M = -0.02
FORCE_NOISE_N = 0.02
ENCODER_STEP_M = 5e-6


@dataclass(frozen=True)
class SpringDamper:
    """F = k x + c v, never pulling."""

    k: float
    c: float

    def push_n(self, x: float, v: float) -> float:
        """Compression [N] at depth `x` [m] and rate `v` [m/s]."""
        return max(0.0, self.k * x + self.c * v) if x > 0.0 else 0.0


@dataclass
class Mass:
    """A mass on a rail with friction, between two walls."""

    mass_kg: float
    friction_n_s_m: float
    x: float
    v: float = 0.0

    def advance(self, force_n: float, dt_s: float) -> None:
        """Semi-implicit Euler over one substep."""
        self.v += dt_s * (force_n - self.friction_n_s_m * self.v) / self.mass_kg
        self.x += dt_s * self.v
        if abs(self.x) > WALL_M:
            self.x, self.v = math.copysign(WALL_M, self.x), 0.0


@dataclass(frozen=True)
class HandArm:
    """Spring and damper of a human arm towards where it wants to be (de Vlugt et al., Biol. Cybern. 2002)."""

    plan: Callable[[float], tuple[float, float]]  # time [s] to position [m] and velocity [m/s]
    stiffness_n_m: float = 600.0
    damping_n_s_m: float = 12.0

    def force_n(self, time_s: float, x: float, v: float) -> float:
        """Push on the device [N]."""
        wanted_m, wanted_m_s = self.plan(time_s)
        return self.stiffness_n_m * (wanted_m - x) + self.damping_n_s_m * (wanted_m_s - v)


def presses(
    depth_m: float, clear_m: float, times_s: tuple[tuple[float, float], ...], ramp_s: float = 0.5
) -> Callable[[float], tuple[float, float]]:
    """A plan: `depth_m` inside between each pair of times, `clear_m` outside otherwise; smooth ramps."""

    def plan(time_s: float) -> tuple[float, float]:
        share = rate = 0.0
        for begin_s, end_s in times_s:
            for at_s, sign in ((begin_s, 1.0), (end_s, -1.0)):
                u = min(1.0, max(0.0, (time_s - at_s) / ramp_s))
                share += sign * u * u * (3.0 - 2.0 * u)
                rate += sign * 6.0 * u * (1.0 - u) / ramp_s
        way_m = depth_m + clear_m
        return -clear_m + way_m * share, way_m * rate

    return plan


# True values of each step, free of sensors: felt is the leader's motor against the hand, positive outwards;
# driven is the follower's motor.
TRACE = ("time_s", "hand_m", "hand_m_s", "felt_n", "follower_m", "object_n", "driven_n")


def run(
    coupling: Coupling,
    thing: SpringDamper,
    hand: HandArm,
    faults: LinkFaults,
    duration_s: float,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Let a hand, which yields to forces, work on an object through a coupling.

    Returns:
        The columns of `TRACE`, one value a step.
    """
    rng = np.random.default_rng(seed)
    to_leader, to_follower = DelayLine[Packet](faults, rng), DelayLine[Packet](faults, rng)
    noise_n = FORCE_NOISE_N * np.random.default_rng([seed, 1]).standard_normal(round(duration_s / DT_S))
    leader, follower = coupling.leader(), coupling.follower()
    channels = coupling.channel(), coupling.channel()
    device, arm, rows = Mass(0.15, 0.5, START_M), Mass(1.0, 5.0, START_M), []
    for tick, noise in enumerate(noise_n):
        time_s = tick * DT_S
        hand_n, push_n = hand.force_n(time_s, device.x, device.v), thing.push_n(arm.x, arm.v)
        for channel, line in zip(channels, (to_leader, to_follower), strict=True):
            for number, packet in line.arrived(time_s):
                channel.take(number, packet)
        at_leader, at_follower = (channel.packet() for channel in channels)
        led_n, aim = leader.step(DevicePort(_read(device.x), device.v, hand_n), at_leader, DT_S)
        at_arm = DevicePort(_read(arm.x), arm.v, push_n + noise)
        driven_n, answer = follower.step(at_arm, at_follower, DT_S)
        to_follower.send(aim, time_s)
        to_leader.send(answer, time_s)
        led_n, driven_n = (clip(force_n, -DEVICE_LIMIT_N, DEVICE_LIMIT_N) for force_n in (led_n, driven_n))
        rows.append((time_s, device.x, device.v, -led_n, arm.x, push_n, driven_n))
        for substep in range(SUBSTEPS):
            at_s = time_s + substep * SUBSTEP_S
            device.advance(led_n + hand.force_n(at_s, device.x, device.v), SUBSTEP_S)
            arm.advance(driven_n - thing.push_n(arm.x, arm.v), SUBSTEP_S)
    return dict(zip(TRACE, np.array(rows).T, strict=True))


def _read(position_m: float) -> float:
    """What an encoder shows."""
    return round(position_m / ENCODER_STEP_M) * ENCODER_STEP_M


def returned_energy_j(trace: dict[str, np.ndarray]) -> np.ndarray:
    """Energy that the leader's motor has given to the hand, above what it took; at each step [J].

    Everything behind that motor begins at rest: if it is passive, this never rises above zero.
    """
    return np.concatenate([[0.0], np.cumsum(-trace["felt_n"][:-1] * np.diff(trace["hand_m"]))])
