"""Interfaces of drivers, and functions that start and stop several of them.

Blocking work happens in `Bus.poll` and `Bus.flush`, each with a deadline.

Before its first sample a device returns NaN, sampled at minus infinity, with `Status.STALE`, rather than a
zero that looks measured. Samples come from `configure` on, with the torque still off, so that an arm can be
observed before it is powered.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType
from typing import Literal, Self

from palpate.robot_io.errors import DeviceError
from palpate.robot_io.types import FloatArray, Reading


class Component:
    """Anything with a lifecycle: configure once, then activate and deactivate any number of times.

    Each step does nothing unless a driver overrides it.
    """

    def configure(self) -> None:
        """Open the device; raise `DeviceError` if it is absent or not the expected model."""

    def activate(self) -> None:
        """Prepare for commands; program the device's own watchdog and read it back.

        Raises:
            DeviceError: the device refused.
        """

    def verify(self) -> None:
        """Check after a run that the device is still set up as before; raise `DeviceError` if it is not."""

    def deactivate(self) -> None:
        """Switch the torque off. Works in every state, also after a failure, and can be called again."""

    def close(self) -> None:
        """Release ports and memory; can be called repeatedly."""


class Bus(Component, ABC):
    """Line that one or more devices share; it is polled once and flushed once in each tick."""

    @abstractmethod
    def poll(self, deadline_s: float) -> None:
        """Read the newest samples of all devices on this bus; raise `DeviceError` if the bus itself failed.

        A device that does not answer keeps its old sample, whose reading then has `Status.STALE`.

        Args:
            deadline_s: end of waiting, robot's clock; a past deadline means no waiting [s].
        """

    @abstractmethod
    def flush(self, deadline_s: float) -> None:
        """Send the commands staged by the devices on this bus; raise `DeviceError` if the bus itself failed.

        Args:
            deadline_s: end of waiting, robot's clock [s].
        """


class JointComponent(Component, ABC):
    """A component of all joints."""

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Number of joints n."""


class JointEncoder(JointComponent):
    """Positions and velocities of all joints."""

    @abstractmethod
    def read_position(self) -> Reading:
        """Return the newest positions, shape (n,) [rad]; never blocks."""

    @abstractmethod
    def read_velocity(self) -> Reading:
        """Return the newest velocities, shape (n,) [rad/s]; never blocks."""


class JointTorque(JointComponent):
    """Torque-controlled drives of all joints."""

    @abstractmethod
    def read_torque(self) -> Reading:
        """Return the newest measured torques, shape (n,), along the joint axes [N m]; never blocks."""

    @abstractmethod
    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """Stage torques for the next flush; never blocks.

        Args:
            torque_nm: shape (n,), positive along the joint axis [N m].

        Returns:
            Torques that will be sent, after the drive's resolution and range, shape (n,) [N m].
        """


class ForceSensor(Component, ABC):
    """A uniaxial force sensor at the tool."""

    @abstractmethod
    def read_force(self) -> Reading:
        """Return the newest force, shape (1,), positive in compression [N]; never blocks."""


_ATTEMPTS = 3  # attempts at a step that is interrupted, for example by several Ctrl-C
LabeledComponent = tuple[str, Component]
"""Name of a component in messages, and the component."""


class ManagedDevice(ABC):
    """Context manager that configures and closes; an error in closing never hides an earlier error."""

    @abstractmethod
    def configure(self) -> None:
        """Open the device; raise `DeviceError` if one is absent or not the expected model."""

    @abstractmethod
    def close(self) -> None:
        """Switch off torque or force, and release the device; can be called repeatedly."""

    def __enter__(self) -> Self:
        self.configure()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self.close()
        except DeviceError as failure:
            if error is None:
                raise
            error.add_note(f"closing failed too: {failure}")


def start_all(
    components: Sequence[LabeledComponent],
    step: Literal["configure", "activate"],
    *,
    undo: Literal["close", "deactivate"],
) -> None:
    """Apply a step to each component in order; if one fails, undo it and all earlier ones.

    The failing component is undone too: a drive may have powered two of three motors before it failed.

    Args:
        components: components with their names for messages.
        step: step to apply.
        undo: the reverse step.

    Raises:
        DeviceError: a component failed. Other interruptions (such as Ctrl-C) pass unchanged.
    """
    for index, (label, component) in enumerate(components):
        try:
            getattr(component, step)()
        except BaseException as error:
            problem = f"{label}: {step} failed: {error}"
            try:
                undo_all(components[: index + 1], undo)
            except DeviceError as second:
                problem += f"; then {second}"
                error.add_note(problem)
            if isinstance(error, DeviceError):
                raise DeviceError(problem) from error
            raise


def undo_all(components: Sequence[LabeledComponent], step: Literal["close", "deactivate"]) -> None:
    """Apply a step to every component, last one first, even after failures.

    After a Ctrl-C, the interrupted step is repeated, the others follow, and then the interrupt is raised
    again.

    Args:
        components: components with their names for messages.
        step: step to apply.

    Raises:
        DeviceError: some components failed; the error names all of them.
    """
    failures: list[tuple[str, Exception]] = []
    interrupts: list[BaseException] = []
    for label, component in reversed(components):
        for _ in range(_ATTEMPTS):
            try:
                getattr(component, step)()
            except Exception as error:  # a driver's bug must not leave the next motor on
                failures.append((label, error))
                break
            except BaseException as interrupt:
                interrupts.append(interrupt)
            else:
                break
    if interrupts:
        raise interrupts[0]
    if failures:
        text = "; ".join(f"{label}: {step} failed: {error}" for label, error in failures)
        raise DeviceError(text) from failures[0][1]
