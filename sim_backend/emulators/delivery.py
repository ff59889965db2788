"""What becomes of frames between a device and its host: dropped, damaged, exchanged, late, doubled."""

from abc import abstractmethod
from typing import Generic, TypeVar

from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.faults import FaultKind, Faults

Frame = TypeVar("Frame")
Device = str | int


class FrameWire(EmulatedWire, Generic[Frame]):
    """A wire whose frames go wrong one by one; a kind of wire says how they are sent and damaged.

    Faults may be added at any time.
    """

    def __init__(self, faults: Faults | None) -> None:
        self.faults = faults or Faults()
        self._late: list[tuple[float, Frame]] = []
        self._held_back: dict[Device, Frame] = {}

    @abstractmethod
    def _put(self, frame: Frame, now_s: float) -> None:
        """Send a frame to the host, if it is there."""

    @abstractmethod
    def _damaged(self, device: Device, frame: Frame, now_s: float) -> Frame:
        """What arrives of a device's frame by the faults that change it."""

    def _deliver(self, device: Device, frame: Frame, now_s: float) -> None:
        """Send a device's frame as the faults let it."""
        strikes = self.faults.strikes
        if strikes(FaultKind.DROP, device, now_s):
            return
        frame = self._damaged(device, frame, now_s)
        if strikes(FaultKind.REORDER, device, now_s) and device not in self._held_back:
            self._held_back[device] = frame
            return
        if delay := strikes(FaultKind.DELAY, device, now_s):
            self._late.append((now_s + delay.delay_s, frame))
            return
        self._put(frame, now_s)
        if strikes(FaultKind.DUPLICATE, device, now_s):
            self._put(frame, now_s)
        if device in self._held_back:
            self._put(self._held_back.pop(device), now_s)

    def _deliver_late(self, now_s: float) -> None:
        """Send what was held up until now."""
        due = [frame for due_s, frame in self._late if due_s <= now_s]
        self._late = [late for late in self._late if late[0] > now_s]
        for frame in due:
            self._put(frame, now_s)
