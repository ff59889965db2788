"""The simulated arm behind all emulated wires, its motors' shafts, and the bench that lets time pass."""

import select
import termios
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import Status
from palpate.sim_backend.hooks import NO_EFFECTS, HiddenEffects
from palpate.sim_backend.scenario import Scenario
from palpate.sim_backend.world import world_of

_REST_SHARE = 0.04  # of a joint's torque limit


@dataclass(frozen=True, slots=True)
class JointState:
    """What a motor's own sensors show of its joint."""

    position_rad: float  # joint angle [rad]
    velocity_rad_s: float  # its rate [rad/s]
    torque_nm: float  # torque at the joint [N m]


class Plant:
    """An arm in a simulated world, as its motors and its force sensor see it.

    It stands on its rest, and rubs there, until a motor first exerts 4 % of its limit in the robot file: what
    a driver tries out at activation moves nothing. Its sensors are as good as those of the direct simulation.
    It begins at `start_s` on the bench's clock [s]. Not safe for threads: one bench owns it.
    """

    def __init__(
        self, robot_file: RobotFile, scenario: Scenario, start_s: float, effects: HiddenEffects = NO_EFFECTS
    ) -> None:
        self.world = world_of(robot_file, scenario, effects, start_s)
        self.world.held = True
        self._torque_nm = [0.0] * self.world.joint_count
        self._rest_nm = [_REST_SHARE * limit for limit in robot_file.limits.torque_nm]
        self._joints = [JointState(angle, 0.0, 0.0) for angle in robot_file.home_rad]
        # The newest, positive in compression [N], and how far to trust it; None before the first.
        self.force: tuple[float, Status] | None = None

    def set_torque(self, joint: int, torque_nm: float) -> None:
        """What the motor of `joint` (from 0) exerts from now on [N m].

        Args:
            joint: from 0.
            torque_nm: along the joint's axis [N m].
        """
        if torque_nm == self._torque_nm[joint]:
            return
        if abs(torque_nm) > self._rest_nm[joint]:
            self.world.held = False
        self._torque_nm[joint] = torque_nm
        self.world.set_torque(self._torque_nm)

    def advance_to(self, time_s: float) -> None:
        """Let physics pass up to `time_s` [s] on the bench's clock, and sample all sensors.

        Args:
            time_s: bench's clock [s].
        """
        world = self.world
        world.advance_to(time_s)
        motion, torque = world.encoder.read(time_s), world.torque_sensor.read(time_s)
        if motion is not None and torque is not None:
            n = world.joint_count
            self._joints = [
                JointState(motion.value[i], motion.value[n + i], torque.value[i]) for i in range(n)
            ]
        force = world.force_sensor.read(time_s)
        if force is not None:
            self.force = (force.value[0], force.status)

    def joint(self, joint: int) -> JointState:
        """The newest sample of `joint` (from 0).

        Args:
            joint: from 0.
        """
        return self._joints[joint]

    def close(self) -> None:
        """End the world. Can be called again."""
        self.world.close()


class Shaft:
    """What a motor does to its joint, from 0, and what its own sensors see of it.

    Attributes:
        beside: the other motor's end, where two turn the joint.
        torque_nm: what the motor exerts [N m].
        limp: whether the motor exerts nothing, whatever it is told.
        backwards: whether it exerts the opposite.
        slipped_rad: how far its horn has slipped on the joint [rad].
    """

    def __init__(self, plant: Plant, joint: int) -> None:
        self._plant, self._joint = plant, joint
        self.beside: Shaft | None = None
        self.torque_nm = self.slipped_rad = 0.0
        self.limp = self.backwards = False

    def exert(self, torque_nm: float) -> None:
        """What the motor is to exert from now on [N m]; with what a second one does, it moves the joint.

        Args:
            torque_nm: of this motor at the joint [N m].
        """
        self.torque_nm = 0.0 if self.limp else -torque_nm if self.backwards else torque_nm
        self._plant.set_torque(self._joint, self._together_nm)

    @property
    def _together_nm(self) -> float:
        return self.torque_nm + (self.beside.torque_nm if self.beside else 0.0)

    def state(self) -> JointState:
        """The newest sample; what is wrong with the torque's reading is shared by both motors."""
        state = self._plant.joint(self._joint)
        if self.beside:
            off_nm = 0.5 * (state.torque_nm - self._together_nm)
            state = replace(state, torque_nm=self.torque_nm + off_nm)
        if self.slipped_rad:
            state = replace(state, position_rad=state.position_rad + self.slipped_rad)
        return state


STEP_S = 0.5e-3  # devices look at their wire this often


class EmulatedWire(ABC):
    """One wire with its devices."""

    @abstractmethod
    def receive(self, now_s: float) -> None:
        """Take in what has come over the wire, and act on it.

        Args:
            now_s: bench's clock [s].
        """

    @abstractmethod
    def send(self, now_s: float) -> None:
        """Put on the wire what is due.

        Args:
            now_s: bench's clock [s].
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the wire. Can be called again."""

    def fileno(self) -> int:
        """A file that becomes readable when something has come, or -1: in real time it is heeded at once."""
        return -1

    def next_due_s(self) -> float:
        """When something is due on the wire [s]."""
        return inf


class Bench:
    """Lets time pass for a plant and its wires, in steps of half a millisecond.

    On a simulated clock everything happens inside the clock's advance, so that runs are repeatable. On any
    other, `start` lets a thread keep up with it; in a process of its own it disturbs no control loop.
    """

    def __init__(self, plant: Plant, wires: Sequence[EmulatedWire], clock: Clock) -> None:
        self.plant = plant
        self._wires = tuple(wires)
        self._clock = clock
        self._now_s = clock.now_s()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False
        if isinstance(clock, SimulatedClock):
            clock.subscribe(self.advance_to)

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to `time_s` [s].

        Args:
            time_s: bench's clock [s].
        """
        while not self._closed and self._now_s < time_s - 1e-9:
            for wire in self._wires:
                wire.receive(self._now_s)
            self._step_towards(time_s)

    def _step_towards(self, time_s: float) -> None:
        self._now_s = min(self._now_s + STEP_S, time_s)
        self.plant.advance_to(self._now_s)
        for wire in self._wires:
            wire.send(self._now_s)

    def start(self) -> None:
        """Keep up with a real clock in a thread until `close`."""
        self._thread = threading.Thread(target=self._run, name="emulators", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            # Wait until something comes over a wire or is due on one, and at most for a step.
            now_s = self._clock.now_s()
            due_s = min((wire.next_due_s() for wire in self._wires), default=inf)
            files = [file for wire in self._wires if (file := wire.fileno()) >= 0]
            select.select(files, [], [], max(0.0, min(now_s + STEP_S, due_s) - now_s))
            now_s = self._clock.now_s()
            while self._now_s < now_s:
                self._step_towards(now_s)
            for wire in self._wires:  # what has come by now has come now, not a step ago
                wire.receive(self._now_s)

    def close(self) -> None:
        """End the thread, the wires and the world. Can be called again."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if not self._closed:
            self._closed = True
            for wire in self._wires:
                wire.close()
            self.plant.close()


def heard_at(master: int, baud_rate: int | None) -> bool:
    """Whether what the host sends makes sense to a device at `baud_rate` [bit/s]; any does for None.

    The host has set the speed at the other end of `master`, the device's file. A rate that has no number in
    termios cannot be told from others.

    Args:
        master: file descriptor of the device's end.
        baud_rate: of the device [bit/s]; None for any.
    """
    speed = getattr(termios, f"B{baud_rate}", None)
    return speed is None or termios.tcgetattr(master)[4] == speed
