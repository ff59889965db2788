"""Faults of an emulated wire, and their effect on the frames between a device and its host."""

from abc import abstractmethod
from collections import Counter, defaultdict
from collections.abc import Iterable
from enum import StrEnum
from math import inf
from typing import Annotated, Generic, TypeVar

import numpy as np
from pydantic import Field

from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive
from palpate.sim_backend.emulators.hardware import EmulatedWire


class FaultKind(StrEnum):
    """Kind of fault. An emulator supports the kinds that its wire and its devices can have."""

    DROP = "drop"  # a frame of the device is not sent
    DELAY = "delay"  # a frame is sent `delay_s` late
    CORRUPT = "corrupt"  # one bit of a frame is flipped after its checksum was computed
    LOSE = "lose"  # one byte of a frame is lost; not on CAN, where such a frame is rejected
    DUPLICATE = "duplicate"  # a frame is sent twice
    REORDER = "reorder"  # a frame is swapped with the next one
    WRONG_ID = "wrong_id"  # a frame carries another device's id
    ALERT = "alert"  # the device reports an error
    REBOOT = "reboot"  # the device restarts with its power-up settings, silent for `delay_s`
    UNPLUG = "unplug"  # the port or interface is gone
    STUCK = "stuck"  # the sensor's value is frozen
    NOT_A_NUMBER = "not_a_number"  # the sensor sends a value that is not a number
    SATURATED = "saturated"  # the sensor sends the end of its range
    REVERSED = "reversed"  # the sensor's sign is wrong, or the motor's
    LIMP = "limp"  # the motor exerts no torque, but otherwise works
    DEAF = "deaf"  # a servo ignores new goals and keeps its last one
    SLIPPED = "slipped"  # the motor's horn slips on its joint, by 0.1 rad


class Fault(FileModel):
    """One fault; a test scenario is a list of faults."""

    kind: FaultKind  # kind of fault
    # Device, by its name or number in the emulator; None for every device.
    device: str | int | None = None
    from_s: NotNegative = 0.0  # start, after the start of the emulator [s]
    for_s: Positive | None = None  # duration [s]; None for no end
    # Largest number of occurrences; None for no limit.
    times: Annotated[int, Field(gt=0, strict=True)] | None = None
    # Probability at each opportunity, from 0 to 1.
    probability: Annotated[Number, Field(gt=0, le=1)] = 1.0
    delay_s: NotNegative = 0.0  # delay, or duration of absence, for the kinds that need it [s]


class Faults:
    """Decides at each opportunity whether a fault occurs; equal seeds give equal faults.

    The emulator started at `start_s` on its own clock [s]. `generator` draws the details, such as which bit
    is flipped.
    """

    def __init__(self, faults: Iterable[Fault] = (), *, seed: int = 0, start_s: float = 0.0) -> None:
        self._planned: defaultdict[FaultKind, list[Fault]] = defaultdict(list)
        self._occurrences: Counter[tuple[FaultKind, int]] = Counter()  # by kind and index in its list
        self._start_s = start_s
        self.add(*faults)
        self.generator = np.random.default_rng(seed)

    @property
    def planned(self) -> bool:
        """Whether any fault is planned, now or later."""
        return bool(self._planned)

    def add(self, *faults: Fault) -> None:
        """Plan further faults, even while the emulator runs."""
        for fault in faults:
            self._planned[fault.kind].append(fault)

    def clear(self) -> None:
        """Remove all faults."""
        self._planned.clear()
        self._occurrences.clear()

    def trigger(self, kind: FaultKind, device: str | int, now_s: float) -> Fault | None:
        """Draw whether a fault of this kind occurs in a device now; each call is one opportunity.

        Args:
            kind: kind of fault.
            device: name or number of the device in its emulator.
            now_s: emulator's clock [s].
        """
        for index, fault in enumerate(self._planned.get(kind, ())):
            if (
                fault.device in (None, device)
                and 0.0 <= now_s - self._start_s - fault.from_s < (fault.for_s or inf)
                and self._occurrences[kind, index] < (fault.times or inf)
                and (fault.probability == 1.0 or self.generator.random() < fault.probability)
            ):
                self._occurrences[kind, index] += 1
                return fault
        return None

    def lose_a_byte(self, frame: bytes) -> bytes:
        """Remove one byte of a frame, drawn at random.

        Args:
            frame: at least one byte.
        """
        index = int(self.generator.integers(len(frame)))
        return frame[:index] + frame[index + 1 :]

    def flip_a_bit(self, frame: bytes) -> bytes:
        """Flip one bit of a frame, drawn at random.

        Args:
            frame: at least one byte.
        """
        changed = bytearray(frame)
        index = int(self.generator.integers(len(frame)))
        changed[index] ^= 1 << int(self.generator.integers(8))
        return bytes(changed)


Frame = TypeVar("Frame")
Device = str | int


class FrameWire(EmulatedWire, Generic[Frame]):
    """Wire with faults of single frames; subclasses define how frames are sent and damaged.

    Faults may be added at any time.

    Attributes:
        stalls: whether a late frame holds back all frames behind it, as on a serial line that stalls.
            Otherwise later frames overtake it.
    """

    stalls = False

    def __init__(self, faults: Faults | None) -> None:
        self.faults = faults or Faults()
        self._late: list[tuple[float, Frame]] = []
        self._held_back: dict[Device, Frame] = {}

    @abstractmethod
    def _put(self, frame: Frame, now_s: float) -> None:
        """Send a frame to the host, if it is connected."""

    @abstractmethod
    def _damaged(self, device: Device, frame: Frame, now_s: float) -> Frame:
        """Return a device's frame after the faults that change it."""

    def _deliver(self, device: Device, frame: Frame, now_s: float) -> None:
        """Send a device's frame, subject to the faults."""
        trigger = self.faults.trigger
        if trigger(FaultKind.DROP, device, now_s):
            return
        frame = self._damaged(device, frame, now_s)
        if trigger(FaultKind.REORDER, device, now_s) and device not in self._held_back:
            self._held_back[device] = frame
            return
        delay, is_held_back = trigger(FaultKind.DELAY, device, now_s), self.stalls and self._late
        if delay or is_held_back:
            due_s = now_s + (delay.delay_s if delay else 0.0)
            self._late.append((max(due_s, self._late[-1][0]) if is_held_back else due_s, frame))
            return
        self._put(frame, now_s)
        if trigger(FaultKind.DUPLICATE, device, now_s):
            self._put(frame, now_s)
        if device in self._held_back:
            self._put(self._held_back.pop(device), now_s)

    def _deliver_late(self, now_s: float) -> None:
        """Send frames that were delayed until now."""
        if not self._late:
            return
        due = [frame for due_s, frame in self._late if due_s <= now_s]
        self._late = [late for late in self._late if late[0] > now_s]
        for frame in due:
            self._put(frame, now_s)
