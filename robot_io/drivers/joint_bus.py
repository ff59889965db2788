"""A bus whose devices turn all joints: its encoders and drives, and requests that wait for answers."""

from abc import abstractmethod
from collections import deque
from collections.abc import Mapping
from math import inf
from typing import ClassVar

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.files.file_model import FileModel, input_error
from palpate.robot_io.interfaces import Bus, JointComponent, JointEncoder, JointTorque
from palpate.robot_io.types import FloatArray, Reading


def check_one_per_joint(context: DriverContext, count: int, devices: str) -> None:
    """Raise `InputError` if a bus has more or fewer drives than the arm has joints.

    Args:
        context: Context of the bus.
        count: Number of its drives.
        devices: Name for messages, such as "motors".
    """
    joint_count = context.robot_file.joint_count
    if count != joint_count:
        problem = f"has {count} {devices}, but home_rad has {joint_count}; give one per joint"
        raise input_error(context.robot_file.document, context.section, problem)


class JointBus(Bus, JointComponent):
    """A bus whose devices turn all joints.

    Attributes:
        position: newest positions of all joints [rad], as of the last poll.
        velocity: newest velocities [rad/s].
        torque: newest measured torques [N m].
    """

    position: Reading
    velocity: Reading
    torque: Reading

    @abstractmethod
    def power_on(self) -> None:
        """Switch all drives on at zero torque; raise `DeviceError` if one refuses."""

    @abstractmethod
    def power_off(self) -> None:
        """Switch the torque of all drives off, whatever their state, and drop a staged command.

        Raises:
            DeviceError: a drive did not confirm; all were commanded.
        """

    @abstractmethod
    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`; raise `LifecycleError` while the torque is off."""


class _BusDevice(JointComponent):
    bus_type: ClassVar[type[JointBus]]
    Settings: ClassVar[type[FileModel]] = FileModel  # settings of the device; the bus has its own

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._settings = context.settings_as(self.Settings, settings)
        self._bus = context.bus_as(self.bus_type)

    @property
    def joint_count(self) -> int:
        return self._bus.joint_count


class BusEncoder(_BusDevice, JointEncoder):
    """Positions and velocities that a bus reports."""

    def read_position(self) -> Reading:
        return self._bus.position

    def read_velocity(self) -> Reading:
        return self._bus.velocity


class BusTorque(_BusDevice, JointTorque):
    """The drives on a bus."""

    def activate(self) -> None:
        self._bus.power_on()

    def deactivate(self) -> None:
        self._bus.power_off()

    def read_torque(self) -> Reading:
        return self._bus.torque

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        return self._bus.stage(torque_nm)


def joint_drivers(
    bus_type: type[JointBus], prefix: str, encoder: type[BusEncoder] = BusEncoder
) -> tuple[type[BusEncoder], type[BusTorque]]:
    """Make the drivers `<prefix>_encoder` and `<prefix>_torque` of a bus, for the registry to find.

    Args:
        bus_type: class of the bus, in whose module both are assigned.
        prefix: start of their names in a robot file.
        encoder: base class of the encoder.
    """
    shared = {"bus_type": bus_type, "__module__": bus_type.__module__}
    return (
        type("Encoder", (encoder,), {"name": f"{prefix}_encoder", **shared}),
        type("Torque", (BusTorque,), {"name": f"{prefix}_torque", **shared}),
    )


_ADAPTATION = 0.05  # share by which the usual delay follows a shorter one
_MOST_DOUBTS = 3  # consecutive doubts that stay open before the longer delay counts as usual


class RequestQueue:
    """Requests to one device without an answer so far; an answer belongs to the oldest of them.

    After a lost answer, all later answers would get the time of a request that is one too old. A lost answer
    cannot be distinguished from a longer delay as long as the requests are evenly spaced. So if an answer
    takes longer than usual while further requests are open, one request is omitted (`omit_next`). The answers
    show the same gap, and only one assignment of answers to requests then gives all of them the same delay.
    If none does, because the delay has changed meanwhile, an answer still belongs to the oldest request: its
    time may be too old, but not too new.

    Args:
        margin_s: Variation of the delays [s]; less than the time between two requests.
        latest_s: Longest time between a request and its answer [s].

    Attributes:
        answered_s: When the last answer was requested, robot's clock [s]; the latest possible time if not
            `is_unsure`.
    """

    def __init__(self, margin_s: float, latest_s: float) -> None:
        self._margin_s, self._latest_s = margin_s, latest_s
        self._usual_s = 0.0  # usual delay of an answer [s]
        self._open_s: deque[float] = deque()
        self.answered_s = -inf
        # While `is_unsure`: times of the requests since the first uncertain one, and of the answers.
        self._requested_s: list[float] = []
        self._arrived_s: list[float] = []
        self._most_lost = 0  # largest number of these requests whose answers may be lost
        self._after_gap = inf  # index of the first request after the omitted one
        self._omits_next = False
        self._doubts = 0  # number of consecutive periods that ended unresolved

    @property
    def is_unsure(self) -> bool:
        """Whether it is still unknown which requests were lost."""
        return bool(self._arrived_s)

    def omit_next(self) -> bool:
        """Return whether to omit the request that is due now; true once in each period of `is_unsure`."""
        omits, self._omits_next = self._omits_next, False
        if omits:
            self._after_gap = len(self._requested_s)
        return omits

    def forget(self) -> None:
        """Give up the open requests, whose answers are lost."""
        self._open_s.clear()
        self._arrived_s.clear()

    def ask(self, now_s: float) -> None:
        """Note a request that is sent now.

        Args:
            now_s: robot's clock [s].
        """
        self._expire(now_s)
        self._open_s.append(now_s)
        if self.is_unsure:
            self._requested_s.append(now_s)

    def answer(self, arrived_s: float) -> bool:
        """Remove the answered request, whose time becomes `answered_s`; return whether one was open.

        Args:
            arrived_s: When the answer arrived, robot's clock [s].
        """
        self._expire(arrived_s)
        if not self._open_s:
            return False
        self.answered_s = self._open_s.popleft()
        delay_s = max(arrived_s - self.answered_s, 0.0)
        if self.is_unsure:
            self._arrived_s.append(arrived_s)
            self._resolve(delay_s)
        elif self._open_s and delay_s > self._usual_s + self._margin_s:
            self._requested_s, self._arrived_s = [self.answered_s, *self._open_s], [arrived_s]
            self._most_lost, self._after_gap, self._omits_next = len(self._open_s), inf, True
        else:
            self._usual_s = max(delay_s, self._usual_s + _ADAPTATION * (delay_s - self._usual_s))
        return True

    def _resolve(self, delay_s: float) -> None:
        """End `is_unsure` once one number of lost answers explains all; `delay_s` applies if none is lost."""
        possible = [lost for lost in range(self._most_lost + 1) if self._explains(lost)]
        lost = max(possible, default=0)
        if lost == 0:
            self._arrived_s.clear()
            self._doubts += 1
            if possible or self._doubts > _MOST_DOUBTS:
                self._usual_s, self._doubts = max(delay_s, self._usual_s), 0
        elif len(possible) == 1:
            newest = lost + len(self._arrived_s) - 1
            delay_s = max(self._arrived_s[-1] - self._requested_s[newest], 0.0)
            # One loss at the usual delay is seen at the gap. Anything else could be a loss after a longer
            # delay, until the answers have passed every place where the gap would then be.
            is_one = lost == 1 and abs(delay_s - self._usual_s) <= self._margin_s
            has_passed = len(self._arrived_s) > self._most_lost + 1 and newest > self._after_gap
            if newest >= self._after_gap and (is_one or has_passed):
                for _ in range(lost):
                    self.answered_s = self._open_s.popleft()
                self._arrived_s.clear()
                self._usual_s, self._doubts = max(delay_s, self._usual_s), 0

    def _explains(self, lost: int) -> bool:
        """Return whether all answers have the same delay if the first `lost` answers were lost."""
        requested_s = self._requested_s[lost:]
        if len(requested_s) < len(self._arrived_s):
            return False
        pairs = zip(self._arrived_s, requested_s, strict=False)
        delays_s = [arrived_s - asked_s for arrived_s, asked_s in pairs]
        return min(delays_s) >= -self._margin_s and max(delays_s) - min(delays_s) <= self._margin_s

    def _expire(self, now_s: float) -> None:
        while self._open_s and now_s - self._open_s[0] > self._latest_s:
            self._open_s.popleft()
            self._arrived_s.clear()
