"""Runs emulated devices and the world behind them, in lock-step with a simulated clock or in real time."""

import select
import termios
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import inf

from robot_io.clock import Clock, SimulatedClock
from sim_backend.emulators.plant import Plant

STEP_S = 0.5e-3  # devices look at their wire this often


class EmulatedWire(ABC):
    """One wire with its devices."""

    @abstractmethod
    def receive(self, now_s: float) -> None:
        """Take in what has come over the wire, and act on it."""

    @abstractmethod
    def send(self, now_s: float) -> None:
        """Put on the wire what is due."""

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
        """Let time pass up to `time_s` [s]."""
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
            self._await_traffic()
            now_s = self._clock.now_s()
            while self._now_s < now_s:
                self._step_towards(now_s)
            for wire in self._wires:  # what has come by now has come now, not a step ago
                wire.receive(self._now_s)

    def _await_traffic(self) -> None:
        """Wait until something comes over a wire or is due on one, and at most for a step."""
        now_s = self._clock.now_s()
        due_s = min((wire.next_due_s() for wire in self._wires), default=inf)
        files = [file for wire in self._wires if (file := wire.fileno()) >= 0]
        select.select(files, [], [], max(0.0, min(now_s + STEP_S, due_s) - now_s))

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
    """
    wanted = getattr(termios, f"B{baud_rate}", None)
    return wanted is None or termios.tcgetattr(master)[4] == wanted
