"""ODrive axes on a CAN bus, in torque mode through CANSimple.

The axes send cyclic messages, and answer rare requests, which show the delay. If it grows by up to 1 ms after
the configuration, for 0.3 s by up to 3 ms, or for 30 ms by any step that is no gap, this stays unnoticed. The
axes must be set up over USB beforehand: node id, bit rate, rates of the cyclic messages (encoder estimates,
and motor current with firmware 0.5 or torques with 0.6, at the control rate), current limit and watchdog.
"""

from collections.abc import Mapping
from functools import partial
from math import inf, tau
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers import odrive_protocol as odrive
from palpate.robot_io.drivers.can.line import CanFrame, CanLineSettings
from palpate.robot_io.drivers.can.motors import ATTEMPTS, MotorBus, MotorMounting
from palpate.robot_io.drivers.joint_bus import joint_drivers
from palpate.robot_io.drivers.odrive_protocol import AxisState, Firmware, Heartbeat, OdriveCommand
from palpate.robot_io.drivers.odrive_stream import ASK_PERIOD_S, AnswerDelay, EstimateStream
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.examination import Finding, fail, ok, warn
from palpate.robot_io.files.file_model import Positive, TorqueConstant
from palpate.robot_io.guard.limits import Torque


class OdriveAxis(MotorMounting):
    """One axis."""

    node_id: Annotated[int, Field(ge=0, le=odrive.MAX_NODE_ID, strict=True)]  # its CAN node id
    max_torque_nm: Torque  # largest motor torque, from its current limit [N m]
    # Current limit for this torque [A]. If stated, each activation writes it to the axis, with a velocity
    # limit above this file's (Set_Limits); otherwise both keep their values from USB.
    current_limit_a: Annotated[Positive, Field(le=1000)] | None = None
    # Motor torque per ampere, needed with firmware 0.5, which reports current [N m/A].
    torque_constant_nm_a: TorqueConstant | None = None


class OdriveBusSettings(CanLineSettings):
    """Settings in the robot file."""

    firmware: Firmware  # "0.5" or "0.6"
    axes: Annotated[tuple[OdriveAxis, ...], Field(min_length=1)]  # one per joint, from base to tip
    heartbeat_s: Annotated[Positive, Field(le=1)] = 0.1  # period of the heartbeats [s]
    # After how long without a command an axis disarms itself [s], as set on the axis. Every watchdog is left
    # to expire once at each activation, to see that it works.
    watchdog_s: Annotated[Positive, Field(le=1)] = 0.1

    @model_validator(mode="after")
    def _check_consistency(self) -> "OdriveBusSettings":
        ids = [axis.node_id for axis in self.axes]
        if len(set(ids)) != len(ids):
            raise ValueError(f"axes: node ids {ids} are not all different")
        if self.firmware is Firmware.V0_5 and any(axis.torque_constant_nm_a is None for axis in self.axes):
            raise ValueError("axes: firmware 0.5 reports current, so axes need a torque_constant_nm_a")
        return self


_OBEYED_SHARE = 0.8  # a motor exerts too little below this share of the sent torque
_CLEAR_SHARE = 0.02  # minus this share of its largest torque,
_SHORT_SAMPLES = 5  # in so many consecutive samples
_SPARE_SPEED = 1.5  # multiple of the robot file's limit, so that the guard stops the arm before an axis fails
_LOST_HEARTBEATS = 3.5  # heartbeat periods without a heartbeat after which the axis is lost
_FEWEST_BEATS = 2  # in that time, when the axis is configured
_LATENCY_ROUNDS = 3  # measurements of an axis's answering time, of which the shortest counts
_LATEST_ANSWER_S = 0.05  # longest wait for an answer
_SECOND_ANSWER_S = 2e-3  # after this time, a second axis with the same id has answered too
_TRIAL_TORQUE, _TRIAL_SPEED = 0.01, 0.1  # shares of the largest torque and speed that test the mode
_WINDOWS = 3  # attempts to receive messages at the right rate; the machine may be busy
_ENCODER_ERRORS = {"ENCODER_FAILED", "MISSING_ESTIMATE", "SPINOUT_DETECTED", "UNKNOWN_POSITION"}


def _is_double(share: float) -> bool:
    """Return whether a rate, as a share of the stated one, is about twice that."""
    return 1.6 <= share <= 2.5


class OdriveBus(MotorBus):
    """ODrive axes on a CAN bus.

    Heartbeats are monitored: an axis has failed if it reports an error, leaves closed-loop control on its
    own, or sends no heartbeat. CANSimple cannot read the watchdog's settings, so activation tests the
    watchdog by letting it expire.
    """

    name = "odrive_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(OdriveBusSettings, settings)
        super().__init__(validated, validated.axes, context)
        self._settings, self._control_rate_hz = validated, context.robot_file.control_rate_hz
        self._axes, count = validated.axes, len(validated.axes)
        self._joint_by_node = {axis.node_id: joint for joint, axis in enumerate(validated.axes)}
        self._heartbeats: list[Heartbeat | None] = [None] * count
        self._heartbeat_at_s = [-inf] * count
        self._supply_v: dict[int, float] = {}
        self._answered_at_s, self._answers = [-inf] * count, [0] * count
        self._beats = [0] * count  # heartbeats since a window began
        self._start_streams([0.0] * count)
        self._versions: dict[int, tuple[int, int, int]] = {}
        self._sent_nm, self._expected_nm = [0.0] * count, [0.0] * count  # at the motors
        self._setpoint_nm = [0.0] * count  # as the axes report it
        self._short_nm, self._short_count = [0.0] * count, [0] * count

    def motor_label(self, joint: int) -> str:
        return f"joint {joint + 1} (node {self._axes[joint].node_id})"

    def configure(self) -> None:
        """Open the adapter, receive data from every axis, check the firmware, and set all axes to idle.

        Raises:
            DeviceError: the adapter cannot be opened; an axis is silent, of another firmware, or sends at
            another rate; or two axes have one node id.
        """
        self.line.open()
        self._send_all(self._frames(OdriveCommand.SET_AXIS_STATE, AxisState.IDLE))
        self._send_all(self._frames(OdriveCommand.GET_VERSION))
        self._wait_for(self._all_answered, self._heartbeat_timeout_s)
        for joint in range(self.joint_count):
            if problem := self._setup_problem(joint):
                raise self._motor_error(joint, problem)
        # The answering time corrects the times of the samples: CAN frames carry no time, and a constant delay
        # would go unnoticed. A silent axis is assumed to have no delay.
        self._check_heartbeats()
        self._start_streams(self._measure_latencies())
        for joint in range(self.joint_count):
            self._check_rate(joint, self._motion_at_s, self._limits.encoder_age_s, "encoder")
            self._check_rate(joint, self._torque_at_s, self._limits.torque_age_s, "torque")

    def _start_streams(self, latencies_s: list[float]) -> None:
        """Follow the axes' messages from now on, after delays (n) [s]."""
        now_s, limit_s = self._clock.now_s(), self._limits.encoder_age_s
        self._delays = [
            AnswerDelay(latency_s, now_s + 1e-3 * (joint + 1), limit_s)
            for joint, latency_s in enumerate(latencies_s)
        ]
        self._streams = [EstimateStream(now_s) for _ in latencies_s]

    def _check_heartbeats(self) -> None:
        """Raise a DeviceError if heartbeats come too rarely, or twice as often, and voltages unasked."""
        total, seconds = [0] * self.joint_count, 0.0
        self._answers = [0] * self.joint_count
        for _ in range(_WINDOWS):
            self._beats = [0] * self.joint_count
            begun_s = self._clock.now_s()
            self._wait_for(lambda: False, self._heartbeat_timeout_s)
            seconds += self._clock.now_s() - begun_s
            total = [before + count for before, count in zip(total, self._beats, strict=True)]
            share = [count * self._settings.heartbeat_s / seconds for count in total]
            if min(self._beats) >= _FEWEST_BEATS and not any(_is_double(one) for one in share):
                break
        else:
            for joint, count in enumerate(total):
                stated_s, remedy = self._settings.heartbeat_s, f"set {self._rate_commands[0]}"
                if count < _WINDOWS * _FEWEST_BEATS:
                    problem = f"sent {count} heartbeats in {seconds:.2g} s, too few for heartbeat_s"
                    raise self._motor_error(joint, f"{problem} {stated_s:g}; {remedy}")
                if _is_double(share[joint]):
                    problem = f"heartbeats come twice as often as stated (heartbeat_s: {stated_s:g})"
                    raise self._two_axes(joint, f"{problem}; if only one axis has this id, {remedy}")
        for joint, count in enumerate(self._answers):
            if count:
                setting = odrive.VOLTAGE_PERIOD[self._settings.firmware]
                problem = (
                    "sends its supply voltage without a request, so the delay of its answers cannot be "
                    "measured"
                )
                raise self._motor_error(joint, f"{problem}; set {setting} = 0")

    def _measure_latencies(self) -> list[float]:
        """Return the shortest answering times (n) [s], 0 for a silent axis; refuse two answers of an id."""
        latencies_s, self._answers = [inf] * self.joint_count, [0] * self.joint_count
        for _ in range(_LATENCY_ROUNDS):
            self._answered_at_s = [inf] * self.joint_count
            asked_s = self._clock.now_s()
            self._send_all(self._frames(OdriveCommand.BUS_VOLTAGE_CURRENT))
            self._wait_for(lambda: inf not in self._answered_at_s, _LATEST_ANSWER_S)
            latencies_s = [
                min(latency_s, max(at_s - asked_s, 0.0))
                for latency_s, at_s in zip(latencies_s, self._answered_at_s, strict=True)
            ]
            self._wait_for(lambda: False, _SECOND_ANSWER_S)
        for joint, count in enumerate(self._answers):
            if count > _LATENCY_ROUNDS + 1:  # one frame may have been sent twice
                raise self._two_axes(joint, f"{count} answers to {_LATENCY_ROUNDS} requests")
        return [0.0 if latency_s == inf else latency_s for latency_s in latencies_s]

    def _two_axes(self, joint: int, evidence: str) -> DeviceError:
        node = self._axes[joint].node_id
        return self._motor_error(joint, f"two axes have node id {node}: {evidence}")

    def poll(self, deadline_s: float) -> None:
        """See `MotorBus.poll`; without torque, also asks for the delay."""
        try:
            super().poll(deadline_s)
        finally:
            if not (self._powered or self.line.bus_off):
                self._ask_delays(deadline_s)

    def flush(self, deadline_s: float) -> None:
        # Any frame feeds a watchdog, so with torque a request only goes out with a command.
        is_commanded = bool(self._staged)
        super().flush(deadline_s)
        if is_commanded:
            self._ask_delays(deadline_s)

    def _ask_delays(self, deadline_s: float) -> None:
        """Ask the first axis whose delay is due to be measured."""
        now_s = self._clock.now_s()
        for axis, delay in zip(self._axes, self._delays, strict=True):
            if delay.is_due(now_s):
                delay.ask(now_s)
                self._send(odrive.encode_command(axis.node_id, OdriveCommand.BUS_VOLTAGE_CURRENT), deadline_s)
                return

    def _drain(self, deadline_s: float) -> None:
        super()._drain(deadline_s)
        now_s = self._clock.now_s()
        for joint, stream in enumerate(self._streams):
            stream.check_rate(now_s)
            self._motion_is_wrong[joint] |= bool(self._evidence_of_two_axes(joint))

    def _evidence_of_two_axes(self, joint: int) -> str:
        return self._streams[joint].problem or self._delays[joint].problem

    def _report(self) -> list[Finding]:
        self._drain(self._clock.now_s())  # frames from before are no answers
        self._heartbeats = [None] * self.joint_count
        self._motion_at_s, self._torque_at_s = [-inf] * self.joint_count, [-inf] * self.joint_count
        for message in (OdriveCommand.BUS_VOLTAGE_CURRENT, OdriveCommand.GET_VERSION):
            self._send_all(self._frames(message))
        count = self.joint_count
        self._wait_for(
            lambda: self._all_answered() and len(self._supply_v) == count, self._heartbeat_timeout_s
        )
        unseen = "make sure that each axis has these settings, which CAN cannot read: "
        unseen += "; ".join(self._setup_commands)
        return [*map(self._observe, range(self.joint_count)), ok("set over USB", unseen)]

    def _observe(self, joint: int) -> Finding:
        label, beat, supply_v = self.motor_label(joint), self._heartbeats[joint], self._supply_v.get(joint)
        if beat is None:
            remedy = f"check its power, cable, node id and bit rate; {self._rate_commands[0]}"
            return fail(label, "sends no heartbeat", remedy)
        if problem := self._setup_problem(joint):
            return fail(label, problem, f"over USB: {'; '.join(self._setup_commands)}")
        version = self._versions.get(self._axes[joint].node_id)
        firmware = f"firmware {'.'.join(map(str, version)) if version else self._settings.firmware}"
        supply = "supply voltage not reported" if supply_v is None else f"{supply_v:.1f} V"
        value = f"{firmware}, {supply}, {self._describe(beat)}"
        if supply_v is not None and supply_v < odrive.UNDERVOLTAGE_V:
            return fail(label, value, "switch its power supply on")
        if beat.axis_error or beat.component_errors:
            return warn(label, value, "activation clears errors; find their cause first")
        return ok(label, value)

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: estimates, torques, command and share of a request of each axis."""
        request_s = (self._frame_s(0) + self._frame_s(8)) / (ASK_PERIOD_S * self._control_rate_hz)
        return self.joint_count * (2 * self._frame_s(8) + self._frame_s(4) + request_s)

    def power_on(self) -> None:
        """See `JointBus.power_on`; checks node ids and watchdogs first."""
        self._measure_latencies()  # refuses a second axis that has joined since the configuration
        self._refuse_two_axes()
        self._send_all(self._frames(OdriveCommand.CLEAR_ERRORS, 0))  # once: later errors are not cleared
        self._heartbeats = [None] * self.joint_count
        self._arm()
        bit = odrive.WATCHDOG_EXPIRED[self._settings.firmware]

        def armed() -> list[int]:
            return [j for j, beat in enumerate(self._heartbeats) if not (beat and beat.axis_error & bit)]

        limit_s = self._settings.watchdog_s + self._heartbeat_timeout_s
        if not self._wait_for(lambda: not armed(), limit_s):
            raise DeviceError(
                f"{self.line.label}: the watchdog of {', '.join(map(self.motor_label, armed()))} did not "
                f"expire in {limit_s:.2g} s without commands; set {odrive.ENABLE_WATCHDOG} = True; "
                f"{odrive.WATCHDOG_TIMEOUT} = {self._settings.watchdog_s:g}"
            )
        self._arm()
        self._refuse_two_axes()
        self._powered = True

    def _refuse_two_axes(self) -> None:
        for joint in range(self.joint_count):
            if evidence := self._evidence_of_two_axes(joint):
                raise self._two_axes(joint, evidence)

    def _switch_off(self) -> None:
        """See `MotorBus._switch_off`; each axis must confirm by a heartbeat."""
        sent_s = self._clock.now_s()

        def still_on() -> list[int]:
            return [
                joint
                for joint, beat in enumerate(self._heartbeats)
                if beat is None or beat.state is not AxisState.IDLE or self._heartbeat_at_s[joint] <= sent_s
            ]

        joints = list(range(self.joint_count))
        for _ in range(ATTEMPTS):
            frames = []
            for node in (self._axes[joint].node_id for joint in joints):
                frames.append(odrive.encode_input_torque(node, 0.0))
                frames.append(odrive.encode_command(node, OdriveCommand.SET_AXIS_STATE, AxisState.IDLE))
            self._send_all(frames)
            if self._wait_for(lambda: not still_on(), self._heartbeat_timeout_s):
                return
            joints = still_on()
        labels = ", ".join(map(self.motor_label, joints))
        raise DeviceError(f"{self.line.label}: idle state is not confirmed by {labels}")

    @property
    def _heartbeat_timeout_s(self) -> float:
        return _LOST_HEARTBEATS * self._settings.heartbeat_s

    def _frames(self, command: OdriveCommand, *values: float) -> list[CanFrame]:
        """Make a command, or the request for a message, for each axis."""
        return [odrive.encode_command(axis.node_id, command, *values) for axis in self._axes]

    def _all_answered(self) -> bool:
        versions = self._settings.firmware is Firmware.V0_5 or len(self._versions) == len(self._axes)
        moved, pulled = -inf not in self._motion_at_s, -inf not in self._torque_at_s
        return versions and None not in self._heartbeats and moved and pulled

    @property
    def _rate_commands(self) -> tuple[str, ...]:
        """Return the settings that make an axis send heartbeats, estimates and torques often enough."""
        heartbeat_ms = round(1e3 * self._settings.heartbeat_s)
        names = odrive.PERIOD_SETTINGS[self._settings.firmware]
        return tuple(f"{name} = {ms}" for name, ms in zip(names, (heartbeat_ms, 1, 1), strict=True))

    @property
    def _setup_commands(self) -> tuple[str, ...]:
        """Return all settings that an axis needs over USB, as odrivetool commands."""
        limits = (
            f"{odrive.VELOCITY_LIMIT} = {max(map(self._fastest_rev_s, range(self.joint_count))):.1f} or more",
            f"{odrive.CURRENT_LIMIT[self._settings.firmware]} = the current that max_torque_nm needs",
        )
        are_written = all(axis.current_limit_a for axis in self._axes)
        return (
            *self._rate_commands,
            f"{odrive.WATCHDOG_TIMEOUT} = {self._settings.watchdog_s:g}",
            f"{odrive.ENABLE_WATCHDOG} = True",
            f"{odrive.ENABLE_VELOCITY_LIMIT} = False",
            *(() if are_written else limits),
            "odrv0.save_configuration()",
        )

    def _fastest_rev_s(self, joint: int) -> float:
        """Return the speed of a motor at the robot file's velocity limit [rev/s]."""
        return self._limits.velocity_rad_s[joint] * self._axes[joint].gear_ratio / tau

    def _check_rate(self, joint: int, at_s: list[float], oldest_s: float, what: str) -> None:
        """Check that a message arrives in time in one of several attempts."""
        for _ in range(_WINDOWS):
            at_s[joint] = -inf
            self._wait_for(lambda: at_s[joint] > -inf, self._heartbeat_timeout_s)
            at_s[joint] = -inf
            if self._wait_for(lambda: at_s[joint] > -inf, oldest_s):
                return
        command = self._rate_commands[2 if what == "torque" else 1]
        raise self._motor_error(joint, f"does not send its {what} every {oldest_s:g} s; set {command}")

    def _setup_problem(self, joint: int) -> str:
        """Return what an axis does not send, or its wrong firmware; an empty string if its setup is right."""
        if self._heartbeats[joint] is None:
            remedy = f"check its power, cable, node id and bit rate; set {self._rate_commands[0]}"
            return f"no heartbeat in {self._heartbeat_timeout_s:.2g} s; {remedy}"
        version, stated = self._versions.get(self._axes[joint].node_id), self._settings.firmware
        if version is None and stated is Firmware.V0_6:
            return "does not answer Get_Version, as firmware 0.6 would"
        if version is not None and f"{version[0]}.{version[1]}" != stated:
            return f"has firmware {'.'.join(map(str, version))}, but the robot file states {stated}"
        _, encoder, torque = self._rate_commands
        if self._motion_at_s[joint] == -inf:
            last = self._last_problem[joint]
            return f"sends no valid encoder estimates ({last or 'none'}); set {encoder}"
        return f"sends no torques; set {torque}" if self._torque_at_s[joint] == -inf else ""

    def _arm(self) -> None:
        """Go to closed-loop torque control at zero torque, from no error but an expired watchdog.

        Frames to an axis that does not confirm are repeated. The limits cannot be confirmed, and are sent
        twice, like the controller mode, which is tested.
        """
        watchdog = odrive.WATCHDOG_EXPIRED[self._settings.firmware]
        zero_torque = [odrive.encode_input_torque(axis.node_id, 0.0) for axis in self._axes]
        armed_s = self._clock.now_s()

        def missing() -> list[int]:
            self._send_all(zero_torque)  # feeds the watchdogs
            return [
                joint
                for joint, beat in enumerate(self._heartbeats)
                if beat is None
                or beat.state is not AxisState.CLOSED_LOOP_CONTROL
                or beat.axis_error
                or self._heartbeat_at_s[joint] <= armed_s
            ]

        joints = list(range(self.joint_count))
        for _ in range(ATTEMPTS):
            self._send_all([frame for joint in joints for frame in self._arming_frames(joint)])
            if self._wait_for(lambda: not missing(), self._heartbeat_timeout_s):
                self._test_modes()
                return
            joints = missing()
            beats = [self._heartbeats[joint] for joint in joints]
            if any(beat and (beat.axis_error & ~watchdog or beat.component_errors) for beat in beats):
                break  # it occurred after the errors were cleared, or cannot be cleared
        states = "; ".join(
            f"{self.motor_label(joint)} is {self._describe(beat) if beat else 'silent'}"
            for joint, beat in enumerate(self._heartbeats)
        )
        raise DeviceError(f"{self.line.label}: no closed-loop control: {states}")

    def _test_modes(self) -> None:
        """Command small torques and velocities; raise `DeviceError` unless setpoints follow the torque alone.

        CANSimple cannot read the mode. In any other mode, the torque's setpoint also follows the velocity, or
        does not follow at all.
        """
        begun_s = self._clock.now_s()
        self._wait_for(lambda: min(self._torque_at_s) > begun_s, _LATEST_ANSWER_S)
        before_nm, largest = list(self._setpoint_nm), [0.0] * self.joint_count

        def frames(share: float) -> list[CanFrame]:
            return [
                odrive.encode_command(
                    axis.node_id,
                    OdriveCommand.SET_INPUT_VELOCITY,
                    share * _TRIAL_SPEED * self._fastest_rev_s(joint),
                    share * _TRIAL_TORQUE * axis.max_torque_nm,
                )
                for joint, axis in enumerate(self._axes)
            ]

        def have_followed() -> bool:
            self._send_all(frames(1.0))  # also feeds the watchdogs
            for joint, axis in enumerate(self._axes):
                change_nm = abs(self._setpoint_nm[joint] - before_nm[joint])
                largest[joint] = max(largest[joint], change_nm / (_TRIAL_TORQUE * axis.max_torque_nm))
            return min(largest) > 0.5

        self._wait_for(have_followed, _LATEST_ANSWER_S)
        self._send_all(2 * frames(0.0))
        if wrong := [self.motor_label(joint) for joint, share in enumerate(largest) if not 0.5 < share < 1.5]:
            raise DeviceError(
                f"{self.line.label}: not in torque control: {', '.join(wrong)}; the frames that set its mode "
                "may have been lost, so check the bus, and start again"
            )

    def _arming_frames(self, joint: int) -> list[CanFrame]:
        """Return the frames that arm an axis; they clear an expired watchdog, and no other error."""
        axis, beat = self._axes[joint], self._heartbeats[joint]
        encode = partial(odrive.encode_command, axis.node_id)
        settings = [encode(OdriveCommand.SET_CONTROLLER_MODE, odrive.TORQUE_CONTROL, odrive.PASSTHROUGH)]
        if axis.current_limit_a is not None:
            fastest_rev_s = _SPARE_SPEED * self._fastest_rev_s(joint)
            settings.append(encode(OdriveCommand.SET_LIMITS, fastest_rev_s, axis.current_limit_a))
        is_expired = beat is not None and beat.axis_error == odrive.WATCHDOG_EXPIRED[self._settings.firmware]
        return [
            *([encode(OdriveCommand.CLEAR_ERRORS, 0)] if is_expired else []),
            *(2 * [*settings, odrive.encode_input_torque(axis.node_id, 0.0)]),
            encode(OdriveCommand.SET_AXIS_STATE, AxisState.CLOSED_LOOP_CONTROL),
        ]

    def _describe(self, beat: Heartbeat) -> str:
        names = odrive.axis_error_names(beat.axis_error, self._settings.firmware)
        components = tuple(f"{component} error" for component in beat.component_errors)
        return " ".join((beat.state.name, *names, *components))

    def _joint_of(self, frame: CanFrame) -> int | None:
        is_foreign = frame.extended or frame.remote
        return None if is_foreign else self._joint_by_node.get(frame.can_id >> odrive.COMMAND_BITS)

    def _store_frame(self, joint: int, frame: CanFrame, at_s: float) -> bool:
        node, command = divmod(frame.can_id, 1 << odrive.COMMAND_BITS)
        match command:
            case OdriveCommand.ENCODER_ESTIMATES:
                position_rev, velocity_rev_s = odrive.decode_two_floats(frame, "encoder estimates")
                if self._streams[joint].accept(position_rev, velocity_rev_s, self._clock.now_s()):
                    sampled_s = at_s - self._delays[joint].latency_s
                    self._store_motion(joint, tau * position_rev, tau * velocity_rev_s, sampled_s)
            case OdriveCommand.GET_IQ if self._settings.firmware is Firmware.V0_5:
                setpoint_a, current_a = odrive.decode_two_floats(frame, "motor current")
                constant_nm_a = self._axes[joint].torque_constant_nm_a or 0.0
                self._setpoint_nm[joint] = setpoint_a * constant_nm_a
                self._store_torque(joint, current_a * constant_nm_a, at_s - self._delays[joint].latency_s)
            case OdriveCommand.TORQUES if self._settings.firmware is Firmware.V0_6:
                self._setpoint_nm[joint], torque_nm = odrive.decode_two_floats(frame, "motor torque")
                self._store_torque(joint, torque_nm, at_s - self._delays[joint].latency_s)
            case OdriveCommand.HEARTBEAT:
                beat = odrive.decode_heartbeat(frame, self._settings.firmware)
                self._heartbeats[joint], self._heartbeat_at_s[joint] = beat, at_s
                self._beats[joint] += 1
                if self._powered and not self._lost[joint]:
                    self._lost[joint] = self._loss(beat)
                names = odrive.axis_error_names(beat.axis_error, self._settings.firmware)
                is_wrong = "encoder" in beat.component_errors or not _ENCODER_ERRORS.isdisjoint(names)
                self._motion_is_wrong[joint] = is_wrong
            case OdriveCommand.BUS_VOLTAGE_CURRENT:
                self._supply_v[joint], _ = odrive.decode_two_floats(frame, "bus voltage and current")
                self._answered_at_s[joint] = min(self._answered_at_s[joint], at_s)
                self._answers[joint] += 1
                delay = self._delays[joint]
                delay.answer(frame.data, at_s)
                if delay.latency_s > delay.usual_s:
                    self._last_problem[joint] = f"its answers take {1e3 * delay.latency_s:.1f} ms"
            case OdriveCommand.GET_VERSION:
                self._versions[node] = odrive.decode_version(frame)
            case _:
                return False
        return True

    def _store_torque(self, joint: int, shaft_nm: float, at_s: float) -> None:
        """See `MotorBus._store_torque`; counts samples in which a motor exerts too little."""
        least_nm = min(abs(self._sent_nm[joint]), abs(self._expected_nm[joint]))
        self._expected_nm[joint] = self._sent_nm[joint]
        clear_nm = _CLEAR_SHARE * self._axes[joint].max_torque_nm
        is_short = self._powered and abs(shaft_nm) < _OBEYED_SHARE * least_nm - clear_nm
        self._short_count[joint] = self._short_count[joint] + 1 if is_short else 0
        self._short_nm[joint] = shaft_nm
        super()._store_torque(joint, shaft_nm, at_s)

    def _encode_shaft(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        axis = self._axes[joint]
        if self._lost[joint]:  # it may have switched itself on again
            return odrive.encode_command(axis.node_id, OdriveCommand.SET_AXIS_STATE, AxisState.IDLE), 0.0
        motor_nm = min(max(torque_nm, -axis.max_torque_nm), axis.max_torque_nm)
        self._sent_nm[joint] = motor_nm
        return odrive.encode_input_torque(axis.node_id, motor_nm), float(np.float32(motor_nm))

    def _hint(self, joint: int) -> str:
        if self._short_count[joint] < _SHORT_SAMPLES:
            return ""
        return (
            f"exerts {abs(self._short_nm[joint]):.2f} N m at the motor instead of "
            f"{abs(self._sent_nm[joint]):.2f} N m; check whether a setting limits torques; the velocity "
            f"limiter is on by default; to switch it off, set {odrive.ENABLE_VELOCITY_LIMIT} = False"
        )

    def _loss(self, beat: Heartbeat) -> str:
        """Return what in a heartbeat shows that an axis with torque has disarmed; empty if it has not."""
        if beat.axis_error or beat.component_errors:
            return self._describe(beat)
        is_armed = beat.state is AxisState.CLOSED_LOOP_CONTROL
        return "" if is_armed else f"left closed-loop control ({beat.state.name})"

    def _fault(self, joint: int, now_s: float) -> str:
        if evidence := self._evidence_of_two_axes(joint):
            return f"two axes have node id {self._axes[joint].node_id}: {evidence}"
        silent_s = now_s - self._heartbeat_at_s[joint]
        if silent_s > self._heartbeat_timeout_s:
            return f"heartbeat lost; the last one came {silent_s:.2g} s ago"
        beat = self._heartbeats[joint]
        if beat and beat.state is AxisState.CLOSED_LOOP_CONTROL and not self._powered:
            return "is armed, although it was switched off"
        return self._lost[joint]


OdriveEncoder, OdriveTorque = joint_drivers(OdriveBus, "odrive")
