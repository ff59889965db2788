"""Motors on a CAN bus that speak only when they are spoken to.

Each command is answered with the motor's state, which the next poll takes in. While the torque is off, each
poll asks again.
"""

from abc import abstractmethod
from collections.abc import Sequence
from math import inf

from robot_io.driver import DriverContext
from robot_io.drivers.can.line import CanFrame, CanLineSettings
from robot_io.drivers.can.motors import MotorBus, MotorMounting
from robot_io.errors import DeviceError

ANSWER_S = 0.05  # more than any motor takes
_LATEST_WATCHDOG = 1.5  # times its time: it has fired by then


class AskedMotorBus(MotorBus):
    """Motors that answer each frame with their state, and let go `watchdog_s` after the last command [s]."""

    def __init__(
        self,
        line: CanLineSettings,
        mountings: Sequence[MotorMounting],
        context: DriverContext,
        motor_ids: Sequence[int],
        watchdog_s: float,
    ) -> None:
        super().__init__(line, mountings, context)
        self._motor_ids, self._watchdog_s = tuple(motor_ids), watchdog_s
        self._joint_by_id = {motor_id: joint for joint, motor_id in enumerate(motor_ids)}
        self._errors = [0] * len(mountings)
        self._enabled: list[bool | None] = [None] * len(mountings)
        self._answers = [0] * len(mountings)
        self._commanded_s = -inf
        self._command: list[CanFrame] = []
        self._flushed = False

    # What a protocol adds.

    @abstractmethod
    def _ask(self) -> None:
        """Ask motors without torque for their states."""

    @abstractmethod
    def _error_names(self, error: int) -> str:
        """What an error means."""

    def _error(self, joint: int) -> int:
        """What is wrong with a motor; 0 is nothing."""
        return self._errors[joint]

    # What is common.

    def motor_label(self, joint: int) -> str:
        return f"joint {joint + 1} (motor {self._motor_ids[joint]})"

    def _hear_all(self) -> None:
        """Open the adapter and hear every motor. DeviceError: it cannot be opened, or a motor is silent."""
        self.line.open()
        self._ask()
        if not self._wait_for(lambda: -inf not in self._motion_at_s, ANSWER_S):
            silent = [joint for joint, at_s in enumerate(self._motion_at_s) if at_s == -inf]
            labels = ", ".join(map(self.motor_label, silent))
            raise DeviceError(f"{self.line.label}: no answer in {ANSWER_S} s from {labels}")

    def poll(self, deadline_s: float) -> None:
        """See `MotorBus.poll`; where no command has been sent since the last poll, asks for the next one."""
        try:
            super().poll(deadline_s)
        finally:
            if not self.line.bus_off:
                self._request_states()
            self._flushed = False

    def flush(self, deadline_s: float) -> None:
        if self._staged:
            self._commanded_s, self._command, self._flushed = self._clock.now_s(), self._staged, True
        super().flush(deadline_s)

    def _request_states(self) -> None:
        """Make the motors answer: say the last command again, but not for longer than the watchdog's time."""
        if not self._powered:
            self._ask()
        elif not self._flushed:
            forgotten = self._clock.now_s() - self._commanded_s > self._watchdog_s
            self._send_all(self._zero_torque() if forgotten else self._command)

    def _fault(self, joint: int, now_s: float) -> str:
        error = self._error(joint)
        if not error and self._powered and self._enabled[joint] is False:
            return "has left motor mode; has it restarted?"
        return self._error_names(error) if error else ""

    def _zero_torque(self) -> list[CanFrame]:
        return [self._encode_torque(joint, 0.0)[0] for joint in range(self.joint_count)]

    def _send_confirmed(self, frames: list[CanFrame], problem: str, *, enabled: bool) -> None:
        """Send frames, two or more to each motor, and wait until each has answered twice.

        One that says whether it is in motor mode must say `enabled`, or that it has an error.
        """
        self._answers = [0] * self.joint_count
        self._send_all(frames)

        def missing() -> list[str]:
            wrong = [
                not self._error(joint) and found not in (None, enabled)
                for joint, found in enumerate(self._enabled)
            ]
            return [
                self.motor_label(joint)
                for joint, answers in enumerate(self._answers)
                if answers < 2 or wrong[joint]
            ]

        if not self._wait_for(lambda: not missing(), ANSWER_S):
            raise DeviceError(f"{self.line.label}: {problem} {', '.join(missing())}")

    def _answered(self, frames: list[CanFrame]) -> None:
        """Send one frame to each motor and wait for the answers. DeviceError: a motor is silent."""
        self._answers = [0] * self.joint_count
        self._send_all(frames)
        if not self._wait_for(lambda: all(self._answers), ANSWER_S):
            silent = self.motor_label(self._answers.index(0))
            raise DeviceError(f"{self.line.label}: no answer in {ANSWER_S} s from {silent}")

    def _refuse_errors(self, but: int | None = None) -> None:
        """DeviceError: some motors have errors, other than `but`; with their names."""
        errors = [self._error(joint) for joint in range(self.joint_count)]
        problems = [
            f"{self.motor_label(joint)}: {self._error_names(error)}"
            for joint, error in enumerate(errors)
            if error not in (0, but)
        ]
        if problems:
            raise DeviceError(f"{self.line.label}: {'; '.join(problems)}: remove the cause, then restart it")

    def _outlast_watchdogs(self) -> None:
        """Say nothing for longer than motors may go on."""
        self._clock.sleep_until(self._clock.now_s() + _LATEST_WATCHDOG * self._watchdog_s)

    def _refuse_going_on(self, going_on: Sequence[bool], how: str) -> None:
        """DeviceError: some motors went on (n) after the silence, and how that is seen."""
        if any(going_on):
            alive = ", ".join(self.motor_label(joint) for joint, on in enumerate(going_on) if on)
            raise DeviceError(
                f"{self.line.label}: {alive} {how} after {_LATEST_WATCHDOG * self._watchdog_s:.2g} s without "
                f"commands; set its timeout to {self._watchdog_s:g} s"
            )
