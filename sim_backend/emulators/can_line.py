"""A CAN bus with emulated motors: their common parts."""

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

import can
from can.interfaces.virtual import VirtualBus

from palpate.robot_io.drivers.can.motors import MotorMounting
from palpate.sim_backend.emulators.hardware import EmulatedWire, JointState, Plant
from palpate.sim_backend.emulators.wiring import WireRequest


def mounting_of(motor: MotorMounting) -> dict[str, float]:
    """Return the keyword arguments of an emulated motor that a robot file states.

    Args:
        motor: its settings in the robot file.
    """
    ratio = -motor.gear_ratio if motor.reversed else motor.gear_ratio
    return {"gear_ratio": ratio, "zero_rad": motor.zero_rad}


class EmulatedMotor(ABC):
    """One motor, by its id, on a joint of the plant (from 0).

    Its shaft turns `gear_ratio` times for one turn of the joint, negative if reversed, and is at zero when
    the joint is at `zero_rad` [rad].
    """

    def __init__(
        self, number: int, joint: int, plant: Plant, *, gear_ratio: float = 1.0, zero_rad: float = 0.0
    ) -> None:
        self.number = number
        self._joint, self._plant, self._gear_ratio, self._zero_rad = joint, plant, gear_ratio, zero_rad
        self._heard_s = -math.inf

    @property
    def shaft(self) -> JointState:
        """Angle, speed and torque of its shaft."""
        joint, ratio = self._plant.joints[self._joint], self._gear_ratio
        angle_rad = (joint.position_rad - self._zero_rad) * ratio
        return JointState(angle_rad, joint.velocity_rad_s * ratio, joint.torque_nm / ratio)

    def _exert(self, shaft_nm: float) -> None:
        self._plant.set_torque(self._joint, shaft_nm * self._gear_ratio)

    @abstractmethod
    def receive(self, message: can.Message, now_s: float) -> list[can.Message]:
        """Act on a frame on the bus, and return the answers.

        Args:
            message: for this motor or another.
            now_s: emulator's clock [s].
        """

    @abstractmethod
    def send_unrequested(self, now_s: float) -> list[can.Message]:
        """Check the watchdog, and return the frames that the motor sends without a request, usually none.

        Args:
            now_s: emulator's clock [s].
        """

    @abstractmethod
    def _drive(self) -> None:
        """Apply the commanded torque, if the motor is enabled."""


class CanWire(EmulatedWire):
    """Nodes on a python-can bus, which is opened by the caller and closed by the wire.

    Where the bus preserves stamps, its frames carry the emulator's time.
    """

    def __init__(self, bus: can.BusABC, nodes: Sequence[EmulatedMotor]) -> None:
        self._bus = bus
        self._nodes = tuple(nodes)

    def receive(self, now_s: float) -> None:
        while (message := self._bus.recv(timeout=0.0)) is not None:
            for node in () if message.is_error_frame else self._nodes:
                self._deliver(node, node.receive(message, now_s), now_s)

    def send(self, now_s: float) -> None:
        for node in self._nodes:
            self._deliver(node, node.send_unrequested(now_s), now_s)

    def close(self) -> None:
        self._bus.shutdown()

    def _deliver(self, node: EmulatedMotor, frames: Sequence[can.Message], now_s: float) -> None:
        """Send the frames of a node."""
        for frame in frames:
            self._put(frame, now_s)

    def _put(self, frame: can.Message, now_s: float) -> None:
        frame.timestamp = now_s
        self._bus.send(frame)


class _EmulatorBus(VirtualBus):
    """The devices' end of a virtual bus in lockstep; frames are sent without a copy."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        for end in self.channel:
            if end is not self.queue:
                end.put(msg, timeout=timeout)


_numbers = count()


def make_can_wire(
    request: WireRequest, motors: Sequence[Any], make: Callable[[int, Any], EmulatedMotor]
) -> tuple[EmulatedWire, dict[str, Any]]:
    """Make a bus with one emulated motor per joint; see `WireMaker.make`.

    Args:
        request: the bus to emulate.
        motors: settings of each, from base to tip.
        make: makes a node from joint (from 0) and settings.

    Returns:
        Wire and settings.
    """
    nodes = [make(joint, motor) for joint, motor in enumerate(motors)]
    channel = f"palpate-{os.getpid()}-{next(_numbers)}"
    options: dict[str, Any] = {"preserve_timestamps": request.in_lock_step}
    bus = (_EmulatorBus if request.in_lock_step else VirtualBus)(channel=channel, **options)
    # In lockstep, frames carry the time of the simulated clock, otherwise of the wall clock as on an adapter.
    timestamps = "robot" if request.in_lock_step else "wall"
    reach = {"interface": "virtual", "channel": channel, "options": options, "timestamps": timestamps}
    return CanWire(bus, nodes), reach
