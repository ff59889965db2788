"""A CAN bus with emulated nodes on it, and what can go wrong with their frames."""

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import can
from can.interfaces.virtual import VirtualBus

from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.faults import Fault, FaultKind, Faults

_BUS_OFF_ERROR_FRAME = 0x040  # linux/can/error.h: CAN_ERR_BUSOFF
_STRANGER = 0x7E5  # an id that none of the nodes has


@dataclass(slots=True)
class _Late:
    due_s: float
    message: can.Message = field(repr=False)


class CanNode(ABC):
    """One device on the bus."""

    number: int  # its node or motor id, which faults name it by

    @abstractmethod
    def hear(self, message: can.Message, now_s: float) -> list[can.Message]:
        """Act on a frame; returns the answers."""

    @abstractmethod
    def tell(self, now_s: float) -> list[can.Message]:
        """What the node sends by itself at this time."""

    @abstractmethod
    def strike(self, fault: Fault, now_s: float) -> None:
        """Suffer a fault of the device itself: alert, reboot, or an encoder that is stuck from now on."""


class CanWire(EmulatedWire):
    """Nodes on a python-can bus.

    Faults: a node's frames are dropped, delayed, corrupted, duplicated, reordered or sent under a foreign id;
    unplug takes the whole bus off (an error frame says bus-off, then nothing more).

    Args:
        bus: opened by the caller, closed by the wire; its frames carry the bench's time where it preserves
            stamps.
        nodes: what is connected.
        faults: what goes wrong.
    """

    def __init__(self, bus: can.BusABC, nodes: Sequence[CanNode], faults: Faults | None = None) -> None:
        self._bus = bus
        self._nodes = tuple(nodes)
        self.faults = faults or Faults()
        self._late: list[_Late] = []
        self._held_back: dict[int, can.Message] = {}
        self._unplugged = False

    def receive(self, now_s: float) -> None:
        while (message := self._bus.recv(timeout=0.0)) is not None:
            if self._unplugged or message.is_error_frame:
                continue
            for node in self._nodes:
                self._send(node, node.hear(message, now_s), now_s)

    def send(self, now_s: float) -> None:
        if self._is_unplugged(now_s):
            for node in self._nodes:
                node.tell(now_s)  # to nobody; its watchdog runs all the same
            return
        for late in [late for late in self._late if late.due_s <= now_s]:
            self._late.remove(late)
            self._put(late.message, now_s)
        for node in self._nodes:
            self._strike(node, now_s)
            self._send(node, node.tell(now_s), now_s)

    def close(self) -> None:
        self._bus.shutdown()

    def _is_unplugged(self, now_s: float) -> bool:
        unplugged = self.faults.strikes(FaultKind.UNPLUG, "bus", now_s) is not None
        if unplugged and not self._unplugged:
            self._put(
                can.Message(arbitration_id=_BUS_OFF_ERROR_FRAME, is_error_frame=True, data=bytes(8)), now_s
            )
        self._unplugged = unplugged
        return unplugged

    def _strike(self, node: CanNode, now_s: float) -> None:
        for kind in (FaultKind.ALERT, FaultKind.REBOOT, FaultKind.STUCK):
            fault = self.faults.strikes(kind, node.number, now_s)
            if fault is not None:
                node.strike(fault, now_s)

    def _send(self, node: CanNode, messages: Sequence[can.Message], now_s: float) -> None:
        for message in messages:
            self._send_one(node.number, message, now_s)

    def _send_one(self, number: int, message: can.Message, now_s: float) -> None:
        strikes = self.faults.strikes
        if strikes(FaultKind.DROP, number, now_s):
            return
        if strikes(
            FaultKind.CORRUPT, number, now_s
        ):  # CAN's own CRC catches flipped bits: what gets through is short
            message.data = message.data[:3]
            message.dlc = 3
        if strikes(FaultKind.WRONG_ID, number, now_s):
            if message.is_extended_id:  # the sender stands in the id
                message.arbitration_id = message.arbitration_id & ~0xFF00 | 0xFE00
            else:
                message.arbitration_id = _STRANGER
                message.data = bytearray([0xFE, *message.data[1:]])
        if strikes(FaultKind.REORDER, number, now_s) and number not in self._held_back:
            self._held_back[number] = message
            return
        fault = strikes(FaultKind.DELAY, number, now_s)
        if fault:
            self._late.append(_Late(now_s + fault.delay_s, message))
            return
        self._put(message, now_s)
        if strikes(FaultKind.DUPLICATE, number, now_s):
            self._put(message, now_s)
        earlier = self._held_back.pop(number, None)
        if earlier is not None:
            self._put(earlier, now_s)

    def _put(self, message: can.Message, now_s: float) -> None:
        message.timestamp = now_s
        self._bus.send(message)


class _DevicesEnd(VirtualBus):
    """The devices' end of a virtual bus in lock-step: a frame is made to be sent, and needs no copy."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        for end in self.channel:
            if end is not self.queue:
                end.put(msg, timeout=timeout)


_numbers = count()


def open_virtual_bus(*, in_lock_step: bool) -> tuple[can.BusABC, dict[str, Any]]:
    """The devices' end, opened, and the driver's settings for the other.

    In lock-step frames carry the time of the simulated clock; else the wall clock's, as on a real adapter.
    """
    channel = f"palpate-{os.getpid()}-{next(_numbers)}"
    options: dict[str, Any] = {"preserve_timestamps": in_lock_step}
    bus = (_DevicesEnd if in_lock_step else VirtualBus)(channel=channel, **options)
    timestamps = "robot" if in_lock_step else "wall"
    return bus, {"interface": "virtual", "channel": channel, "options": options, "timestamps": timestamps}
