"""An arm assembled from its devices: lifecycle, one coherent measurement and one command per tick."""

from collections.abc import Mapping
from enum import Enum
from math import inf

import numpy as np

from palpate.robot_io.calibration.applied import (
    CalibratedEncoder,
    CalibratedForceSensor,
    CalibratedTorque,
    Calibrations,
    load_calibrations,
)
from palpate.robot_io.clock import Clock
from palpate.robot_io.driver import DriverCatalog, DriverContext, make_driver
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, InputError, LifecycleError
from palpate.robot_io.interfaces import (
    Bus,
    ForceSensor,
    JointEncoder,
    JointTorque,
    LabeledComponent,
    ManagedDevice,
    start_all,
    undo_all,
)
from palpate.robot_io.robot_file import DeviceSection, RobotFile
from palpate.robot_io.types import Command, FloatArray, Measurement, Reading, Status, frozen_array

_CLOCKS_AGREE_S = 1e-3  # how far a device's converted clock may be ahead of the robot's


class RobotState(Enum):
    """Stage of a robot's lifecycle."""

    NEW = "new"
    CONFIGURED = "configured"  # open and readable, torque off
    ACTIVE = "active"  # obeys commands
    CLOSED = "closed"


class Robot(ManagedDevice):
    """An arm with encoders, torque-controlled drives and a uniaxial force sensor.

    `read` never shows an old sample as a new one: a late sample keeps its value and its time, and its status
    says so. As a context manager it configures on entry and closes on exit, torque off first; activation is
    always explicit. Each bus is polled and flushed once per tick.

    Attributes:
        bus_errors: why the last `read` could not use a bus, by its name; empty if all buses worked.
        bus_delays: why the last `read` got nothing new from a bus in time, by its name.
        sample_errors: why the last `read` rejected a device's sample, by the device.

    Raises:
        InputError: encoder and drives have different numbers of joints.
    """

    def __init__(  # noqa: PLR0917
        self,
        encoder: JointEncoder,
        torque: JointTorque,
        force: ForceSensor,
        buses: Mapping[str, Bus],
        clock: Clock,
        name: str,
    ) -> None:
        if encoder.joint_count != torque.joint_count:
            raise InputError(
                f"{name}: the encoder has {encoder.joint_count} joints, but the drives "
                f"have {torque.joint_count}"
            )
        self.encoder, self.torque, self.force = encoder, torque, force
        self.buses = dict(buses)
        self.clock = clock
        self.name = name
        self.joint_count = torque.joint_count
        self._shape = (self.joint_count,)
        self.bus_errors: dict[str, str] = {}
        self.bus_delays: dict[str, str] = {}
        self.sample_errors: dict[str, str] = {}
        self._state = RobotState.NEW
        self._newest_s = {"encoder": -inf, "torque": -inf, "force": -inf}
        # Started in this order and stopped in reverse: the torque is the last on and the first off.
        self._components: tuple[LabeledComponent, ...] = (
            *((f"bus '{bus_name}'", bus) for bus_name, bus in self.buses.items()),
            ("encoder", encoder),
            ("force sensor", force),
            ("drives", torque),
        )

    @property
    def state(self) -> RobotState:
        """Stage of the lifecycle."""
        return self._state

    def configure(self) -> None:
        """Open every device and check it; opened devices are closed again if one fails.

        Raises:
            DeviceError: a device is absent or not the expected model.
            LifecycleError: the robot is already configured, or closed.
        """
        self._expect("configure", RobotState.NEW)
        start_all(self._components, "configure", undo="close")
        self._state = RobotState.CONFIGURED

    def activate(self) -> None:
        """Prepare for commands; everything is off again if one device fails.

        Raises:
            DeviceError: a device refused.
            LifecycleError: the robot is not configured, or is active already.
        """
        self._expect("activate", RobotState.CONFIGURED)
        start_all(self._components, "activate", undo="deactivate")
        self._state = RobotState.ACTIVE

    def deactivate(self) -> None:
        """Switch the torque off, in any state; can be repeated.

        Raises:
            DeviceError: some devices failed; every one of them was tried. Another call tries again.
        """
        if self._state in (RobotState.CONFIGURED, RobotState.ACTIVE):
            self._state = RobotState.CONFIGURED
            undo_all(self._components, "deactivate")

    def verify(self) -> None:
        """Check after a run that every device is still set up as before.

        Raises:
            DeviceError: a device was changed, or no longer answers; what it measured may be wrong.
        """
        for _, component in self._components:
            component.verify()

    def close(self) -> None:
        """Switch the torque off, then release all devices; can be called repeatedly.

        Raises:
            DeviceError: some devices failed; every one of them was tried.
        """
        if self._state is RobotState.CLOSED:
            return
        try:
            self.deactivate()
        finally:
            self._state = RobotState.CLOSED
            undo_all(self._components, "close")

    def read(self, deadline_s: float) -> Measurement:
        """Poll each bus once and combine the devices' samples.

        A device without a new sample since the last call keeps the old one: `Status.STALE`, or `FAULT` if a
        bus has failed (`bus_errors` says why). A sample from after the poll is a `FAULT` too: some clock is
        wrong. One from after the start of the tick is valid, because polling takes time.

        Args:
            deadline_s: end of the wait, robot's clock [s].

        Raises:
            LifecycleError: the robot is not configured.
            DeviceError: a device returned a wrong shape.
        """
        self._expect("read", RobotState.CONFIGURED, RobotState.ACTIVE)
        time_s = self.clock.now_s()
        self._poll(deadline_s)
        polled_s = self.clock.now_s()
        position, velocity = self.encoder.read_position(), self.encoder.read_velocity()
        torque, force = self.torque.read_torque(), self.force.read_force()
        encoder_at_s = min(position.sampled_at_s, velocity.sampled_at_s)
        encoder_status = max(position.status, velocity.status)
        if force.value.shape != (1,):
            raise DeviceError(f"{self.name}: force has shape {force.value.shape}, expected (1,)")
        force_n = float(force.value[0])
        return Measurement(
            time_s=time_s,
            joint_position_rad=self._joint_values(position, "encoder position"),
            joint_velocity_rad_s=self._joint_values(velocity, "encoder velocity"),
            joint_torque_nm=self._joint_values(torque, "measured torque"),
            force_n=force_n,
            encoder_at_s=encoder_at_s,
            torque_at_s=torque.sampled_at_s,
            force_at_s=force.sampled_at_s,
            encoder_status=self._checked_status("encoder", encoder_at_s, encoder_status, polled_s),
            torque_status=self._checked_status("torque", torque.sampled_at_s, torque.status, polled_s),
            force_status=self._checked_status("force", force.sampled_at_s, force.status, polled_s),
            torque_saturated=torque.saturated,
        )

    def write(self, command: Command, deadline_s: float) -> Command:
        """Send joint torques; return what was sent, after resolution and range of the drives.

        Args:
            command: shape (n,) [N m].
            deadline_s: end of sending, robot's clock [s].

        Raises:
            LifecycleError: the robot is not active.
            InputError: wrong shape or a value that is not finite; nothing was sent.
            DeviceError: a bus failed; the others were flushed.
        """
        self._expect("write", RobotState.ACTIVE)
        torque_nm = frozen_array(command.joint_torque_nm, self._shape, what="joint torque command")
        sent = np.array(self.torque.stage_torque(torque_nm), dtype=np.float64)
        sent.setflags(write=False)
        failures: list[tuple[str, DeviceError]] = []
        for name, bus in self.buses.items():
            try:
                bus.flush(deadline_s)
            except DeviceError as error:
                failures.append((name, error))
        if failures:
            text = "; ".join(f"bus '{name}': {error}" for name, error in failures)
            raise DeviceError(f"{self.name}: command not sent: {text}") from failures[0][1]
        return Command(sent)

    def _expect(self, call: str, *allowed: RobotState) -> None:
        if self._state not in allowed:
            valid = " or ".join(state.value for state in allowed)
            raise LifecycleError(
                f"{self.name}: {call} needs a robot that is {valid}, but this one is {self._state.value}"
            )

    def _poll(self, deadline_s: float) -> None:
        self.bus_errors.clear()
        self.bus_delays.clear()
        self.sample_errors.clear()
        for name, bus in self.buses.items():
            try:
                bus.poll(deadline_s)
            except DeviceTimeoutError as error:  # the devices keep their old samples with their age
                self.bus_delays[name] = str(error)
            except DeviceError as error:
                self.bus_errors[name] = str(error)

    def _checked_status(self, device: str, sampled_at_s: float, status: Status, polled_s: float) -> Status:
        """Return the driver's status, or stale if the sample is not newer than the last (or dated NaN)."""
        if sampled_at_s > polled_s + _CLOCKS_AGREE_S:
            ahead_s = sampled_at_s - polled_s
            self.sample_errors[device] = f"sample from the future, {ahead_s:.4g} s ahead of the robot's clock"
            return Status.FAULT
        if sampled_at_s > self._newest_s[device]:
            self._newest_s[device] = sampled_at_s
            return status
        return max(status, Status.FAULT if self.bus_errors else Status.STALE)

    def _joint_values(self, reading: Reading, what: str) -> FloatArray:
        values = np.array(reading.value, dtype=np.float64)
        if values.shape != self._shape:
            raise DeviceError(f"{self.name}: {what} has shape {values.shape}, expected {self._shape}")
        values.setflags(write=False)
        return values


def build_robot(
    robot_file: RobotFile, drivers: DriverCatalog, clock: Clock, calibrations: Calibrations | None = None
) -> Robot:
    """Assemble the robot that a robot file describes; opens nothing yet.

    Args:
        robot_file: the description.
        drivers: catalog of drivers.
        clock: clock of the robot.
        calibrations: correct the devices; None for those that the robot file names, if they are valid today.

    Raises:
        InputError: a driver has no such name, its settings are invalid, joint counts differ, or a calibration
            is invalid, foreign, or expired.
    """
    if calibrations is None:
        calibrations = load_calibrations(robot_file)
    buses = {
        name: make_driver(
            drivers.bus,
            section.driver,
            section.settings,
            DriverContext(clock, robot_file, section=("buses", name)),
        )
        for name, section in robot_file.buses.items()
    }

    def context(section: DeviceSection, key: str) -> DriverContext:
        bus = buses[section.bus] if section.bus else None
        return DriverContext(clock, robot_file, bus, section=(key,))

    encoder, torque, force = robot_file.encoder, robot_file.torque, robot_file.force
    encoders = make_driver(drivers.encoder, encoder.driver, encoder.settings, context(encoder, "encoder"))
    drives = make_driver(drivers.torque, torque.driver, torque.settings, context(torque, "torque"))
    sensor = make_driver(drivers.force, force.driver, force.settings, context(force, "force"))
    robot = Robot(
        CalibratedEncoder(encoders, calibrations.encoder) if calibrations.encoder else encoders,
        CalibratedTorque(drives, calibrations.torque, robot_file.limits.torque_nm)
        if calibrations.torque
        else drives,
        CalibratedForceSensor(sensor, calibrations.force) if calibrations.force else sensor,
        buses,
        clock,
        robot_file.name,
    )
    if robot.joint_count != robot_file.joint_count:
        raise InputError(
            f"{robot_file.path}: the drives have {robot.joint_count} joints, "
            f"but home_rad has {robot_file.joint_count}"
        )
    return robot
