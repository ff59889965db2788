"""The simulated arm behind all emulated wires, its motors' shafts, and the emulator that advances time."""

import errno
import os
import select
import termios
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import inf
from typing import NamedTuple

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.types import Status
from palpate.sim_backend.scenario import Scenario
from palpate.sim_backend.world import world_of

_REST_SHARE = 0.04  # share of a joint's torque limit below which the arm stays on its rest


class JointState(NamedTuple):
    """Readings of a joint by its motor's own sensors."""

    position_rad: float  # joint angle [rad]
    velocity_rad_s: float  # its rate [rad/s]
    torque_nm: float  # torque at the joint [N m]


class Plant:
    """Arm in a simulated world, with the interfaces of its motors and its force sensor.

    The arm stays on its rest, with friction, until a motor first exerts 4 % of its limit in the robot file,
    so that a driver's test torque at activation moves nothing. Its sensors have the errors of the direct
    simulation. It starts at `start_s` on the emulator's clock [s]. Not thread-safe: one emulator owns it.
    """

    def __init__(self, robot_file: RobotFile, scenario: Scenario, start_s: float) -> None:
        self.world = world_of(robot_file, scenario, start_s)
        self.world.held = True
        self._torque_nm = [0.0] * self.world.joint_count
        self._rest_nm = [_REST_SHARE * limit for limit in robot_file.limits.torque_nm]
        # Newest sample of each joint.
        self.joints = [JointState(angle, 0.0, 0.0) for angle in robot_file.home_rad]
        # Newest force, positive in compression [N], with its status; None before the first.
        self.force: tuple[float, Status] | None = None

    def set_torque(self, joint: int, torque_nm: float) -> None:
        """Set the torque of a joint's motor.

        Args:
            joint: index of the joint, from 0.
            torque_nm: torque along the joint's axis [N m].
        """
        if torque_nm == self._torque_nm[joint]:
            return
        if abs(torque_nm) > self._rest_nm[joint]:
            self.world.held = False
        self._torque_nm[joint] = torque_nm
        self.world.set_torque(self._torque_nm)

    def advance_to(self, time_s: float) -> None:
        """Advance the physics to a time, and sample all sensors.

        Args:
            time_s: emulator's clock [s].
        """
        world = self.world
        world.advance_to(time_s)
        motion, torque = world.encoder.read(time_s), world.torque_sensor.read(time_s)
        if motion and torque and not motion.status == torque.status == Status.STALE:
            n = world.joint_count
            self.joints = [
                JointState(motion.value[i], motion.value[n + i], torque.value[i]) for i in range(n)
            ]
        force = world.force_sensor.read(time_s)
        if force is not None:
            self.force = (force.value[0], force.status)

    def close(self) -> None:
        """Close the world. Can be called repeatedly."""
        self.world.close()


class Shaft:
    """Torque of a motor on its joint (from 0), and readings of its own sensors.

    Attributes:
        beside: the other motor, if two turn the joint.
        torque_nm: torque of the motor [N m].
        limp: whether the motor exerts no torque for any command.
        backwards: whether it exerts the opposite torque.
        slipped_rad: slip angle of its horn on the joint [rad].
    """

    def __init__(self, plant: Plant, joint: int) -> None:
        self._plant, self._joint = plant, joint
        self.beside: Shaft | None = None
        self.torque_nm = self.slipped_rad = 0.0
        self.limp = self.backwards = False

    def exert(self, torque_nm: float) -> None:
        """Set the motor's torque, to which that of a second motor on the joint is added.

        Args:
            torque_nm: torque of this motor at the joint [N m].
        """
        self.torque_nm = 0.0 if self.limp else -torque_nm if self.backwards else torque_nm
        self._plant.set_torque(self._joint, self._total_torque_nm)

    @property
    def _total_torque_nm(self) -> float:
        return self.torque_nm + (self.beside.torque_nm if self.beside else 0.0)

    def state(self) -> JointState:
        """Return the newest sample; both motors share the error of the torque reading."""
        state = self._plant.joints[self._joint]
        if self.beside:
            off_nm = 0.5 * (state.torque_nm - self._total_torque_nm)
            state = state._replace(torque_nm=self.torque_nm + off_nm)
        if self.slipped_rad:
            state = state._replace(position_rad=state.position_rad + self.slipped_rad)
        return state


STEP_S = 0.5e-3  # period at which devices read their wire


class EmulatedWire(ABC):
    """One wire with its devices."""

    @abstractmethod
    def receive(self, now_s: float) -> None:
        """Process received bytes or frames.

        Args:
            now_s: emulator's clock [s].
        """

    @abstractmethod
    def send(self, now_s: float) -> None:
        """Send due bytes or frames.

        Args:
            now_s: emulator's clock [s].
        """

    @abstractmethod
    def close(self) -> None:
        """Release the wire. Can be called repeatedly."""

    def fileno(self) -> int:
        """Return a file descriptor that becomes readable when data arrive, or -1; used in real time."""
        return -1

    def next_due_s(self) -> float:
        """Return the time of the next due data on the wire [s]."""
        return inf

    def flush(self) -> None:  # noqa: B027, most wires pass on their data at once
        """Pass collected data on to the driver, which reads after each advance of a simulated clock."""


class HardwareEmulator:
    """Advances a plant and its wires in steps of half a millisecond.

    On a simulated clock everything happens within the clock's advance, so runs are repeatable. On any other
    clock, `start` runs a thread that follows it; in a separate process it disturbs no control loop.
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
        """Advance plant and wires to a time.

        Args:
            time_s: emulator's clock [s].
        """
        while not self._closed and self._now_s < time_s - 1e-9:
            for wire in self._wires:
                wire.receive(self._now_s)
            self._step_towards(time_s)
        for wire in self._wires:
            wire.flush()

    def _step_towards(self, time_s: float) -> None:
        self._now_s = min(self._now_s + STEP_S, time_s)
        self.plant.advance_to(self._now_s)
        for wire in self._wires:
            wire.send(self._now_s)

    def start(self) -> None:
        """Follow a real clock in a thread until `close`."""
        self._thread = threading.Thread(target=self._run, name="emulators", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            # Wait until data arrive or are due on a wire, and at most for one step.
            now_s = self._clock.now_s()
            due_s = min((wire.next_due_s() for wire in self._wires), default=inf)
            files = [file for wire in self._wires if (file := wire.fileno()) >= 0]
            select.select(files, [], [], max(0.0, min(now_s + STEP_S, due_s) - now_s))
            now_s = self._clock.now_s()
            while self._now_s < now_s:
                self._step_towards(now_s)
            for wire in self._wires:  # received data get the current time, not that of the last step
                wire.receive(self._now_s)

    def close(self) -> None:
        """Stop the thread, and close the wires and the world. Can be called repeatedly."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if not self._closed:
            self._closed = True
            for wire in self._wires:
                wire.close()
            self.plant.close()


class PseudoTerminal:
    """The devices' end of a serial line; the driver opens `path`.

    Args:
        baud_rate: initial value of the attribute.
        kept_open: whether bytes wait for a driver that has not opened its end; otherwise they are lost.

    Attributes:
        baud_rate: baud rate of the devices [bit/s]; None for any. Rates without a number in termios cannot be
            distinguished.
        in_use: whether the driver had opened its end when it was last read.
    """

    def __init__(self, baud_rate: int | None, *, kept_open: bool) -> None:
        self.baud_rate = baud_rate
        self._ends: tuple[int, ...] = os.openpty()
        self._fd, slave = self._ends
        tty.setraw(slave)
        self.path, self.in_use = os.ttyname(slave), False
        os.set_blocking(self._fd, False)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)
        if not kept_open:
            os.close(slave)
            self._ends = self._ends[:1]

    def fileno(self) -> int:
        """Return the file descriptor; -1 while either end is closed, as it would seem readable."""
        return self._fd if self.in_use else -1

    def read(self) -> bytes:
        """Return the bytes that the devices understood, those sent at their baud rate."""
        if self._fd < 0:
            return b""
        data, self.in_use = b"", True
        if self._poll.poll(0):  # faster than a read that fails
            try:
                data = os.read(self._fd, 65536)
            except OSError as error:
                if error.errno not in {errno.EIO, errno.EAGAIN}:
                    raise
                self.in_use = error.errno != errno.EIO  # else the other end is not open
        speed = getattr(termios, f"B{self.baud_rate}", None)
        return data if data and speed in (None, termios.tcgetattr(self._fd)[4]) else b""

    def write(self, data: bytes) -> None:
        """Send bytes; those that the host does not read, or reads too slowly, are lost.

        Args:
            data: bytes.
        """
        if self._fd < 0 or not data:
            return
        try:
            os.write(self._fd, data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise

    def close(self) -> None:
        """Take the line away: the host sees a port that has gone. Can be called repeatedly."""
        for end in self._ends:
            os.close(end)
        self._ends, self._fd = (), -1
