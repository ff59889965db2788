"""Servo arm in the operator's hand: reads the position of its tip, and exerts a force on the hand.

    tau = g(q) + J(q)^T f

The model compensates the arm's weight, and every torque passes the guard. There is no button: the operator
selects a place by pressing the tool's force sensor harder than `select_force_n`.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from palpate.control.arm.rigid_body import RigidBody, TipMotion
from palpate.robot_io.clock import Clock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import DeviceError, InputError, LifecycleError, SafetyTripError
from palpate.robot_io.files.file_model import FileModel, Positive, YamlDocument, load_yaml, validate
from palpate.robot_io.guard import Guard
from palpate.robot_io.operator.device import HandState, OperatorDevice
from palpate.robot_io.registry import Registry
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.types import Command, FloatArray, Measurement, Status

# The leader arm needs kinematics, which `robot_io` does not have.
_PLACES = ("palpate.robot_io.operator", "palpate.control.teleop.leader_arm")

OPERATOR_DEVICES = Registry("operator device", OperatorDevice, *_PLACES)  # type: ignore[type-abstract]
_DEVICE = "device"  # key of the device name in a file, beside the settings


def build_operator_device(
    name: str, settings: Mapping[str, object], clock: Clock, document: YamlDocument | None = None
) -> OperatorDevice:
    """Make an operator device; opens nothing yet.

    Args:
        name: name of the device.
        settings: settings for its `Settings` class.
        clock: clock of this side.
        document: document with the settings, for errors with file and line.

    Raises:
        UnknownNameError: no device has this name.
        InputError: a setting is invalid.
    """
    device = OPERATOR_DEVICES[name]
    return device(validate(device.Settings, settings, document), clock)


def build_operator(operator: str, clock: Clock) -> OperatorDevice:
    """Make an operator device from a name or a YAML file; opens nothing yet.

    Args:
        operator: name of a device, or path of a file that names one and holds its settings.
        clock: clock of this side.

    Raises:
        InputError: the device or file does not exist, or a setting is invalid.
    """
    if operator in OPERATOR_DEVICES:
        try:
            return build_operator_device(operator, {}, clock)
        except InputError as error:
            how = f"give a YAML file with '{_DEVICE}: {operator}' and its settings"
            raise InputError(f"operator '{operator}': {error}; {how}") from error
    valid = ", ".join(OPERATOR_DEVICES)
    if not Path(operator).is_file():
        raise InputError(f"operator '{operator}': no such device or file. Devices: {valid}")
    document = load_yaml(operator)
    name = document.data.get(_DEVICE)
    if not isinstance(name, str) or name not in OPERATOR_DEVICES:
        raise InputError(f"{operator}: '{_DEVICE}' must name one of {valid}")
    rest = {key: value for key, value in document.data.items() if key != _DEVICE}
    return build_operator_device(name, rest, clock, document)


_WAIT_S = 1.0  # time limit for the first sample


class LeaderArmSettings(FileModel):
    """Settings of the leader arm."""

    robot: Path  # robot file
    drivers: tuple[str, ...] = ()  # packages with further drivers
    select_force_n: Positive = 5.0
    deadline_s: Positive = 0.005  # time limit of one exchange with the devices


class LeaderArm(OperatorDevice):
    """Arm as an operator device; `read` reads a measurement, and `set_force` sends a command."""

    name = "leader_arm"
    Settings = LeaderArmSettings
    settings: LeaderArmSettings

    def __init__(self, settings: LeaderArmSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        self._robot: Robot | None = None
        self._measured: Measurement | None = None

    def _open(self) -> None:
        robot_file = load_robot_file(self.settings.robot)
        self._body = RigidBody.of_robot(robot_file)
        self._guard = Guard(
            robot_file.limits, robot_file.safe_state, robot_file.joint_count, self._body.gravity
        )
        self._robot = build_robot(robot_file, DriverCatalog(*self.settings.drivers), self.clock)
        self._robot.configure()
        until_s = self.clock.now_s() + _WAIT_S
        while not np.isfinite(self._measure().joint_position_rad).all():
            if self.clock.now_s() > until_s:
                raise DeviceError(f"{self.name}: the encoders sent nothing within {_WAIT_S:g} s")
            self.clock.sleep_until(self.clock.now_s() + self.settings.deadline_s)

    def _measure(self) -> Measurement:
        return self._arm.read(self.clock.now_s() + self.settings.deadline_s)

    def _hand(self) -> HandState:
        measured = self._measure()
        if self._is_active:
            self._guard.watch(measured)
            if self._guard.tripped and self._guard.finished:
                raise SafetyTripError(f"{self.name}: {self._guard.tripped.cause}")
        if measured.encoder_status is Status.FAULT:
            raise DeviceError(f"{self.name}: the encoders cannot be read {self._arm.bus_errors or ''}")
        self._measured = measured
        tip = self._tip(measured)
        select = measured.force_n > self.settings.select_force_n
        return HandState(tip.position_world_m, tip.velocity_world_m_s, measured.encoder_at_s, select)

    def _power(self, *, on: bool) -> None:
        if not on:
            self._arm.deactivate()
            return
        self._arm.activate()
        self._commanded_s = self.clock.now_s()

    def _push(self, force_world_n: FloatArray) -> FloatArray:
        if self._measured is None:
            raise LifecycleError(f"{self.name}: call read before set_force")
        jacobian = self._tip(self._measured).jacobian_world[:3]
        weight_nm = self._body.gravity(self._measured.joint_position_rad)
        now_s = self.clock.now_s()
        gap_s, self._commanded_s = now_s - self._commanded_s, now_s
        if gap_s > self._guard.longest_hold_up_s:  # the drives may have let go of the arm
            self._guard.trip(f"the program was held up for {gap_s:.3g} s before a command")
        command = Command(weight_nm + jacobian.T @ force_world_n)
        allowed = self._guard.limit(command, self._measured, gap_s)
        sent = self._arm.write(allowed, now_s + self.settings.deadline_s)
        return np.linalg.pinv(jacobian.T) @ (sent.joint_torque_nm - weight_nm)

    def _release(self) -> None:
        if self._robot is not None:
            self._robot.close()
            self._robot = None

    def _tip(self, measured: Measurement) -> TipMotion:
        return self._body.tip_motion(measured.joint_position_rad, measured.joint_velocity_rad_s)

    @property
    def _arm(self) -> Robot:
        if self._robot is None:
            raise LifecycleError(f"{self.name}: not configured")
        return self._robot
