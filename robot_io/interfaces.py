"""What a driver implements. Blocking work happens in `Bus.poll` and `Bus.flush`, each with a deadline.

Before its first sample a device reads NaN, sampled at minus infinity, `Status.STALE`: never a zero that
looks measured. Samples come from `configure` on, with the torque still off, so that an arm can be watched
before it is powered.
"""

from abc import ABC, abstractmethod

from robot_io.types import FloatArray, Reading


class Component:
    """Anything with a lifecycle: configure once, then activate and deactivate any number of times.

    Each step does nothing unless a driver has something to do there.
    """

    def configure(self) -> None:
        """Open what is needed and check that the device is the one expected.

        DeviceError: it is absent or is another model.
        """

    def activate(self) -> None:
        """Make ready for commands; program the device's own watchdog and read it back.

        DeviceError: the device refused.
        """

    def deactivate(self) -> None:
        """Torque off. Works in every state, also after a failure, and can be called again."""

    def close(self) -> None:
        """Release ports and memory. Can be called again."""


class Bus(Component, ABC):
    """A line that one or more devices share; polled once and flushed once in each tick."""

    @abstractmethod
    def poll(self, deadline_s: float) -> None:
        """Bring in the newest samples of all devices on this bus.

        A device that does not answer keeps its old sample, whose reading then says `Status.STALE`. Waiting
        is given up at `deadline_s` on the robot's clock [s]; when that has passed already, take what is
        there.

        DeviceError: the bus itself failed (unplugged, bus-off).
        """

    @abstractmethod
    def flush(self, deadline_s: float) -> None:
        """Send the commands staged by the devices on this bus. DeviceError: the bus itself failed."""


class JointEncoder(Component, ABC):
    """Positions and velocities of all joints."""

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Number of joints n."""

    @abstractmethod
    def read_position(self) -> Reading:
        """Newest positions, shape (n,) [rad]; never blocks."""

    @abstractmethod
    def read_velocity(self) -> Reading:
        """Newest velocities, shape (n,) [rad/s]; never blocks."""


class JointTorque(Component, ABC):
    """Torque-controlled drives of all joints."""

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Number of joints n."""

    @abstractmethod
    def read_torque(self) -> Reading:
        """Newest measured torques, shape (n,), positive along the joint axis [N m]; never blocks."""

    @abstractmethod
    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """Stage torques for the next flush, shape (n,), positive along the joint axis [N m]; never blocks.

        Returns what will really be sent, after the drive's resolution and range, shape (n,) [N m].
        """


class ForceSensor(Component, ABC):
    """A uniaxial force sensor at the tool."""

    @abstractmethod
    def read_force(self) -> Reading:
        """Newest force, shape (1,), positive in compression [N]; never blocks."""
