"""A bus whose devices turn all joints: its encoders and drives, and requests that wait for answers."""

from abc import abstractmethod
from collections import deque
from collections.abc import Mapping
from math import inf
from typing import ClassVar

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.files.file_model import FileModel, input_error
from palpate.robot_io.interfaces import Bus, JointEncoder, JointTorque
from palpate.robot_io.types import FloatArray, Reading


def check_one_per_joint(context: DriverContext, count: int, devices: str) -> None:
    """Check that a bus has as many drives as the arm has joints.

    Args:
        context: Context of the bus.
        count: Number of its drives.
        devices: Name for messages, such as "motors".

    Raises:
        InputError: There are more or fewer.
    """
    joint_count = context.robot_file.joint_count
    if count != joint_count:
        problem = f"has {count} {devices}, home_rad has {joint_count}: one per joint"
        raise input_error(context.robot_file.document, context.section, problem)


class JointBus(Bus):
    """A bus whose devices turn all joints.

    Attributes:
        position: newest positions of all joints [rad], as of the last poll.
        velocity: newest velocities [rad/s].
        torque: newest measured torques [N m].
    """

    position: Reading
    velocity: Reading
    torque: Reading

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Number of joints n."""

    @abstractmethod
    def power_on(self) -> None:
        """Make all drives obey torque commands, at zero torque; raise `DeviceError` if one refused."""

    @abstractmethod
    def power_off(self) -> None:
        """Switch the torque of all drives off, whatever their state, and drop a staged command.

        Raises:
            DeviceError: a drive did not confirm; all were commanded.
        """

    @abstractmethod
    def stage(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`.

        Raises:
            LifecycleError: the torque is off.
        """


class _OnBus:
    bus_type: ClassVar[type[JointBus]]
    Settings: ClassVar[type[FileModel]] = FileModel  # what the robot file says; that of the bus is the rest

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(self.Settings, settings)
        self._bus = context.bus_as(self.bus_type)

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self._bus.joint_count


class BusEncoder(_OnBus, JointEncoder):
    """Positions and velocities that a bus reports."""

    def read_position(self) -> Reading:
        return self._bus.position

    def read_velocity(self) -> Reading:
        return self._bus.velocity


class BusTorque(_OnBus, JointTorque):
    """The drives on a bus."""

    def activate(self) -> None:
        self._bus.power_on()

    def deactivate(self) -> None:
        self._bus.power_off()

    def read_torque(self) -> Reading:
        return self._bus.torque

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        return self._bus.stage(torque_nm)


_ADAPTATION = 0.05  # how far the usual delay follows a shorter one


class RequestQueue:
    """Requests to one device that have no answer yet; an answer belongs to the oldest of them.

    A lost answer would date all later ones too early by one request. So if an answer took longer than usual
    while further requests are open, one request is omitted (`skip`). If the delay is real, the answers to the
    earlier requests keep coming at the same pace. Each answer that stays out indicates a loss.

    Args:
        margin_s: Variation of the delays [s]; less than the time between two requests.
        latest_s: No answer comes later than this after its request [s].
        usual_s: Usual delay before the first answer [s].

    Attributes:
        answered_s: When the last answer was asked for, as far as is known; for sure if not `is_unsure` [s].
    """

    def __init__(self, margin_s: float, latest_s: float, usual_s: float = 0.0) -> None:
        self._margin_s, self._latest_s, self._usual_s = margin_s, latest_s, usual_s
        self._asked_s: deque[float] = deque()
        self.answered_s = -inf
        self._unsure = 0  # how many of the oldest requests may be lost
        self._due_s = 0.0  # when the answer to the first of them is due
        self._skips = False

    @property
    def is_unsure(self) -> bool:
        """Whether it is not known yet which requests are lost."""
        return self._unsure > 0

    def skip(self) -> bool:
        """Return whether to leave out the request that is due now, once for each doubt."""
        skips, self._skips = self._skips, False
        return skips

    def ask(self, now_s: float) -> None:
        """Note a request that is sent now [s].

        Args:
            now_s: robot's clock [s].
        """
        self._expire(now_s)
        self._asked_s.append(now_s)

    def answer(self, arrived_s: float) -> bool:
        """Remove the request to which an answer belongs; `answered_s` becomes its time.

        Args:
            arrived_s: When the answer arrived [s].

        Returns:
            Whether a request was open.
        """
        self._expire(arrived_s)
        self.settle(arrived_s)  # it comes too late for a request whose answer is missing
        if not self._asked_s:
            return False
        was_unsure = self.is_unsure
        self.answered_s = asked_s = self._take_oldest()
        delay_s = max(arrived_s - asked_s, 0.0)
        if not was_unsure and self._asked_s and delay_s > self._usual_s + self._margin_s:
            self._unsure, self._skips = len(self._asked_s), True
        if self._unsure:
            self._due_s = arrived_s + self._asked_s[0] - asked_s + self._margin_s
        else:
            self._usual_s = max(delay_s, self._usual_s + _ADAPTATION * (delay_s - self._usual_s))
        return True

    def settle(self, now_s: float) -> float | None:
        """Give up the oldest request if its answer is overdue.

        Only one is given up at a time. If the delay has grown, giving up more would date all later answers
        too new, which is worse than too old.

        Args:
            now_s: Now, after all answers that have arrived were taken [s].

        Returns:
            When the request was sent that was given up [s]; None if none was. As a rule the last answer was
            to this one, and the answer to one before it is lost.
        """
        if not self._unsure or now_s <= self._due_s:
            return None
        given_up_s = self._take_oldest()
        if self._asked_s:
            self._due_s += self._asked_s[0] - given_up_s
        return given_up_s

    def _expire(self, now_s: float) -> None:
        while self._asked_s and now_s - self._asked_s[0] > self._latest_s:
            self._take_oldest()

    def _take_oldest(self) -> float:
        self._unsure = max(0, self._unsure - 1)
        return self._asked_s.popleft()
