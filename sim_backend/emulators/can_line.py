"""A CAN bus with emulated motors: common parts, and faults of their frames."""

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import count
from typing import Any

import can
from can.interfaces.virtual import VirtualBus

from palpate.robot_io.drivers.can.motors import MotorMounting
from palpate.sim_backend.emulators.faults import Device, Fault, FaultKind, Faults, FrameWire
from palpate.sim_backend.emulators.hardware import EmulatedWire, JointState, Plant
from palpate.sim_backend.emulators.wiring import WireRequest

_BUS_OFF_ERROR_FRAME = 0x040  # linux/can/error.h: CAN_ERR_BUSOFF
_STRANGER = 0x7E5  # an id that none of the nodes has


class EmulatedMotor(ABC):
    """One motor, by its id, on a joint of the plant (from 0); mounted as the robot file states.

    Faults name it by its number.
    """

    def __init__(self, number: int, joint: int, plant: Plant, mounting: MotorMounting) -> None:
        self.number, self._joint, self._plant, self._zero_rad = number, joint, plant, mounting.zero_rad
        # Turns of the shaft for one turn of the joint, negative if reversed.
        self._gear_ratio = -mounting.gear_ratio if mounting.reversed else mounting.gear_ratio
        self._heard_s = self._silent_until_s = -math.inf
        self._stuck: JointState | None = None

    @property
    def shaft(self) -> JointState:
        """True angle, speed and torque of the shaft."""
        return self._at_shaft(self._plant.joints[self._joint])

    @property
    def measured(self) -> JointState:
        """Angle, speed and torque as measured by the motor."""
        return self._at_shaft(self._stuck or self._plant.joints[self._joint])

    def _at_shaft(self, motion: JointState) -> JointState:
        torque_nm = self._plant.joints[self._joint].torque_nm  # which no encoder measures
        ratio = self._gear_ratio
        angle_rad = (motion.position_rad - self._zero_rad) * ratio
        return JointState(angle_rad, motion.velocity_rad_s * ratio, torque_nm / ratio)

    def _exert(self, shaft_nm: float) -> None:
        self._plant.set_torque(self._joint, shaft_nm * self._gear_ratio)

    def receive(self, message: can.Message, now_s: float) -> list[can.Message]:
        """Act on a frame on the bus, unless the motor is starting.

        Args:
            message: for this motor or another.
            now_s: emulator's clock [s].
        """
        return [] if now_s < self._silent_until_s else self._process(message, now_s)

    @abstractmethod
    def _process(self, message: can.Message, now_s: float) -> list[can.Message]:
        """Act on a frame on the bus, and return the answers."""

    @abstractmethod
    def send_unrequested(self, now_s: float) -> list[can.Message]:
        """Check the watchdog, and return the frames that the motor sends without a request, usually none.

        Args:
            now_s: emulator's clock [s].
        """

    def apply_fault(self, fault: Fault, now_s: float) -> None:
        """Apply a fault of the motor itself: alert, reboot, or an encoder that is stuck from now on.

        Args:
            fault: fault to apply.
            now_s: emulator's clock [s].
        """
        if fault.kind is FaultKind.ALERT:
            self._fail()
        elif fault.kind is FaultKind.STUCK:
            self._stuck = self._stuck or self._plant.joints[self._joint]
        elif fault.kind is FaultKind.REBOOT:
            self._start_up()
            self._silent_until_s = now_s + fault.delay_s
        self._drive()

    @abstractmethod
    def _fail(self) -> None:
        """Raise a device error."""

    @abstractmethod
    def _start_up(self) -> None:
        """Reset to the power-up state."""

    @abstractmethod
    def _drive(self) -> None:
        """Apply the commanded torque, if the motor is enabled."""


class CanWire(FrameWire[can.Message]):
    """Nodes on a python-can bus, which is opened by the caller and closed by the wire.

    Faults: a node's frames are dropped, delayed, corrupted, duplicated, reordered or sent under a foreign id;
    unplug takes the whole bus off (an error frame says bus-off, then nothing more). Where the bus preserves
    stamps, its frames carry the emulator's time.
    """

    def __init__(self, bus: can.BusABC, nodes: Sequence[EmulatedMotor], faults: Faults | None = None) -> None:
        super().__init__(faults)
        self._bus = bus
        self._nodes = tuple(nodes)
        self._unplugged = False

    def receive(self, now_s: float) -> None:
        while (message := self._bus.recv(timeout=0.0)) is not None:
            if self._unplugged or message.is_error_frame:
                continue
            for node in self._nodes:
                self._deliver_all(node, node.receive(message, now_s), now_s)

    def send(self, now_s: float) -> None:
        unplugged = self.faults.trigger(FaultKind.UNPLUG, "bus", now_s) is not None
        if unplugged and not self._unplugged:
            bus_off = can.Message(arbitration_id=_BUS_OFF_ERROR_FRAME, is_error_frame=True, data=bytes(8))
            self._put(bus_off, now_s)
        self._unplugged = unplugged
        if unplugged:
            for node in self._nodes:
                node.send_unrequested(now_s)  # discarded; the watchdog runs regardless
            return
        self._deliver_late(now_s)
        for node in self._nodes:
            for kind in (FaultKind.ALERT, FaultKind.REBOOT, FaultKind.STUCK):
                if fault := self.faults.trigger(kind, node.number, now_s):
                    node.apply_fault(fault, now_s)
            self._deliver_all(node, node.send_unrequested(now_s), now_s)

    def close(self) -> None:
        self._bus.shutdown()

    def _deliver_all(self, node: EmulatedMotor, messages: Sequence[can.Message], now_s: float) -> None:
        for message in messages:
            self._deliver(node.number, message, now_s)

    def _damaged(self, device: Device, frame: can.Message, now_s: float) -> can.Message:
        """See `FrameWire._damaged`; CAN's own CRC catches flipped bits, so a damaged frame is shortened."""
        if self.faults.trigger(FaultKind.CORRUPT, device, now_s):
            frame.data = frame.data[:3]
            frame.dlc = 3
        if self.faults.trigger(FaultKind.WRONG_ID, device, now_s):
            if frame.is_extended_id:  # the id contains the sender
                frame.arbitration_id = frame.arbitration_id & ~0xFF00 | 0xFE00
            else:
                frame.arbitration_id = _STRANGER
                frame.data = bytearray([0xFE, *frame.data[1:]])
        return frame

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
    request: WireRequest, nodes: Sequence[EmulatedMotor]
) -> tuple[EmulatedWire, dict[str, Any]]:
    """Make a bus with one emulated motor per joint, and its settings; see `WireMaker.make`.

    Args:
        request: the bus to emulate.
        nodes: motors, from base to tip.
    """
    channel = f"palpate-{os.getpid()}-{next(_numbers)}"
    options: dict[str, Any] = {"preserve_timestamps": request.in_lock_step}
    bus = (_EmulatorBus if request.in_lock_step else VirtualBus)(channel=channel, **options)
    # In lockstep, frames carry the time of the simulated clock, otherwise of the wall clock as on an adapter.
    timestamps = "robot" if request.in_lock_step else "wall"
    reach = {"interface": "virtual", "channel": channel, "options": options, "timestamps": timestamps}
    return CanWire(bus, nodes, request.faults), reach
