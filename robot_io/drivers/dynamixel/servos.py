"""Set up the servos of one Dynamixel bus, from the first ping to torque on and off."""

import struct
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Final, NamedTuple

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.dynamixel import protocol, tables
from palpate.robot_io.drivers.dynamixel.protocol import DynamixelStatus, DynamixelStatusReader, FastReply
from palpate.robot_io.drivers.dynamixel.tables import DynamixelSettings, ServoSettings
from palpate.robot_io.drivers.servo.feedback import FeedbackReader, FeedbackRequest
from palpate.robot_io.drivers.servo.line import RegisterAccess, ServoLine
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.serial_port import SerialPort

_FEEDBACK_REGISTERS: Final = (
    *(tables.TORQUE_ENABLE, tables.HARDWARE_ERROR_STATUS, tables.BUS_WATCHDOG),
    *(tables.PRESENT_CURRENT, tables.PRESENT_VELOCITY, tables.PRESENT_POSITION),
)
_FORMAT: Final = struct.Struct("<BBbhii")
FEEDBACK_SIZE: Final = _FORMAT.size
PADDING: Final = 3  # bytes before the block, see `DynamixelLine.prepare_feedback`

_STATUS_PACKET = 11  # bytes around the data
_LARGEST_ANSWER = _STATUS_PACKET + 4 * (FEEDBACK_SIZE + PADDING) // 3 + 1  # bytes, every third one stuffed


class DynamixelFeedback(NamedTuple):
    """State of all servos, in their own units; each field has one value per servo."""

    error: tuple[int, ...]  # error byte of the answer: 0, or the alert
    torque_on: tuple[int, ...]
    hardware_error: tuple[int, ...]
    watchdog: tuple[int, ...]  # -1 when it has fired
    current: tuple[int, ...]
    velocity: tuple[int, ...]
    position: tuple[int, ...]  # over several turns

    @property
    def fault_texts(self) -> list[str]:
        """Names of each servo's hardware errors, or an empty string."""
        return [
            f"hardware error: {tables.hardware_error_names(hardware_error)}"
            if error or hardware_error
            else ""
            for error, hardware_error in zip(self.error, self.hardware_error, strict=True)
        ]


def decode_feedback(packets: Sequence[DynamixelStatus]) -> DynamixelFeedback:
    """Decode the block at the end of each servo's answer; raise `ProtocolError` if a servo refused.

    Args:
        packets: An answer of at least `FEEDBACK_SIZE` bytes from each servo.
    """
    for packet in packets:
        if packet.refusal:
            raise ProtocolError(f"servo {packet.servo_id} refuses to be read: {packet.refusal}")
    servos = [(error, *_FORMAT.unpack_from(data, len(data) - FEEDBACK_SIZE)) for _, error, data in packets]
    return DynamixelFeedback(*zip(*servos, strict=True))


def feedback_reader(
    port: SerialPort, clock: Clock, servo_ids: Sequence[int], indirect_data: int, *, fast: bool
) -> FeedbackReader[DynamixelFeedback]:
    """Make the reader of the block of all servos.

    Args:
        port: An open port.
        clock: Clock of the deadlines.
        servo_ids: Servos that are asked, in this order.
        indirect_data: Address where the padding starts.
        fast: Whether the servos know the fast sync read.
    """
    ids = tuple(servo_ids)
    ask = protocol.DIALECT.fast_sync_read if fast else protocol.DIALECT.sync_read
    sizes = range(FEEDBACK_SIZE, FEEDBACK_SIZE + PADDING + 1)
    return (_FastReader if fast else FeedbackReader)(
        port,
        clock,
        ids,
        asking={size: ask(indirect_data + PADDING + FEEDBACK_SIZE - size, size, ids) for size in sizes},
        packets=DynamixelStatusReader(_LARGEST_ANSWER),
        decode=decode_feedback,
        overhead=_STATUS_PACKET,
    )


class _FastReader(FeedbackReader[DynamixelFeedback]):
    """Reader of joint packets of all servos; the packet's length identifies its request."""

    _buffer = b""

    @cached_property
    def _replies(self) -> dict[int, FastReply]:
        return {size: FastReply(self._ids, size) for size in self._requests}

    @cached_property
    def _by_length(self) -> dict[bytes, FeedbackRequest]:
        return {self._replies[size].length: request for size, request in self._requests.items()}

    @cached_property
    def _layouts(self) -> dict[int, struct.Struct]:
        """Layout of a servo's part, by the number of requested bytes."""
        return {size: struct.Struct(f"<B{1 + size - FEEDBACK_SIZE}xBBbhii2x") for size in self._requests}

    def _answer_size(self, size: int) -> int:
        return self._replies[size].size

    def _decode_whole(self, request: FeedbackRequest, data: bytes) -> DynamixelFeedback | None:
        parts = self._replies[request.size].valid_parts(self._buffer + data)
        if parts is None:
            return None
        self._buffer = b""
        return DynamixelFeedback(*zip(*self._layouts[request.size].iter_unpack(parts), strict=True))

    def _answers(self, data: bytes) -> Iterator[tuple[FeedbackRequest, Sequence[DynamixelStatus]]]:
        self._buffer = buffer = self._buffer + data
        index, incomplete = 0, -1
        while (start := buffer.find(protocol.FAST_HEADER, index)) >= 0:
            index = start + 1
            request = self._by_length.get(buffer[start + 5 : start + 7])
            if len(buffer) >= start + 7 and request is None:
                continue
            if request is None or start + self._answer_size(request.size) > len(buffer):
                incomplete = start if incomplete < 0 else incomplete
                continue
            end = start + self._answer_size(request.size)
            try:
                packets = self._replies[request.size].decode(buffer[start:end])
            except ProtocolError as error:
                if buffer.find(protocol.FAST_HEADER, index, end) < 0:  # else the next packet cut it off
                    self._problem = str(error)
                    damaged = self._oldest_open()  # its length may be damaged
                    if damaged is not None:
                        self._close(damaged)
                continue
            yield request, packets
            index, incomplete = end, -1
        if incomplete < 0:
            incomplete = max(index, len(buffer) - len(protocol.FAST_HEADER) + 1)
        self._buffer = buffer[incomplete:]

    def _describe_silence(self, request: FeedbackRequest) -> str:
        partial = self._buffer[max(self._buffer.rfind(protocol.FAST_HEADER), 0) :]
        return f"servo {self._ids[self._replies[request.size].answered(partial)]} did not answer in time"


class DynamixelAccess(RegisterAccess):
    """Access to registers of Dynamixel servos, and to the causes of alerts."""

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        super().__init__(protocol.DIALECT, port, clock)

    def servo_label(self, servo_id: int) -> tuple[int, int]:
        """Read model number and firmware version of a servo; raise `DeviceError` as `ping` does."""
        data = self.ping(servo_id, protocol.PING_SIZE)
        return data[0] | data[1] << 8, data[2]

    def setup_problems(self, servo: ServoSettings) -> Iterator[tuple[str, str]]:
        """Yield each invalid setting of a servo, and its remedy; raise `DeviceError` as `read` does.

        Args:
            servo: Its settings in the robot file.
        """
        drive_mode = self.read(servo.id, tables.DRIVE_MODE)
        for trouble in [text for bit, text in tables.DRIVE_MODE_PROBLEMS.items() if drive_mode & bit][:1]:
            yield f"drive mode: {trouble}", "set its drive mode to 0"
        secondary = self.read(servo.id, tables.SECONDARY_ID)
        if secondary < tables.NO_SECONDARY_ID:
            trouble = f"secondary id {secondary}: the servo also obeys commands to id {secondary}"
            yield trouble, "set its secondary id to 255"
        if moved := servo.homing_problem(self.read(servo.id, tables.HOMING_OFFSET)):
            yield moved, "calibrate its zero again, and state the new offset"

    def describe_alert(self, servo_id: int) -> str:
        register = tables.HARDWARE_ERROR_STATUS
        names = tables.hardware_error_names(register.decode(self._read(servo_id, register).data))
        return f" (hardware error: {names}; to clear it, switch the servo off and on)"


class DynamixelLine(ServoLine):
    """See `ServoLine`.

    Attributes:
        current_limits: largest current that each servo takes, in its unit; known after an examination.
    """

    dialect = protocol.DIALECT
    torque_enable = tables.TORQUE_ENABLE
    present_position = tables.PRESENT_POSITION
    goal = tables.GOAL_CURRENT
    ping_size = protocol.PING_SIZE
    ping_all_s = 0.3
    registers: DynamixelAccess
    _settings: DynamixelSettings
    _fast: bool  # whether all servos know the fast sync read, and may use it; set by `identify`

    def __init__(self, settings: DynamixelSettings, port: SerialPort, clock: Clock) -> None:
        super().__init__(settings, DynamixelAccess(port, clock), port, clock)
        self.current_limits: list[int] = []

    def identify(self) -> None:
        """Compare the servos with the settings; raise `DeviceError` if one is silent, old or different."""
        self._check_all_present()
        servos = [(servo, servo.servo_model) for servo in self._settings.turning]
        know_fast = [self._identify(servo) >= model.fast_sync_read_firmware for servo, model in servos]
        self._fast = self._settings.fast_sync_read and all(know_fast)
        read, limit = self.registers.read, tables.CURRENT_LIMIT
        self.current_limits = [min(read(servo.id, limit), model.largest_current) for servo, model in servos]

    def _identify(self, servo: ServoSettings) -> int:
        """Check a servo against the settings and return its firmware version."""
        number, firmware = self.registers.servo_label(servo.id)
        servo.refuse_other_model(number)
        if firmware < tables.WATCHDOG_FIRMWARE:
            raise DeviceError(
                f"servo {servo.id} has firmware {firmware} without a bus watchdog; update it to "
                f"{tables.WATCHDOG_FIRMWARE} or newer"
            )
        self.registers.write_unconfirmed(servo.id, tables.STATUS_RETURN_LEVEL, tables.ANSWER_EVERYTHING)
        for trouble, remedy in self.registers.setup_problems(servo):
            raise DeviceError(f"servo {servo.id}: {trouble}; {remedy}")
        return firmware

    def feedback_reader(self) -> FeedbackReader[DynamixelFeedback]:
        """Make the reader of all servos for each tick, by the fastest method that all of them support."""
        indirect_data = self._settings.servos[0].servo_model.indirect_data
        return feedback_reader(self.port, self.clock, self.ids, indirect_data, fast=self._fast)

    def prepare_feedback(self) -> None:
        """Switch off, map the data of a tick, set delay and watchdog; raise `DeviceError` if one refuses."""
        # Padding comes first: a request can start at any padding byte, so that answers to different requests
        # differ in length and a late answer cannot be taken for a new one.
        block = [register.address + byte for register in _FEEDBACK_REGISTERS for byte in range(register.size)]
        mapped = (*[tables.TORQUE_ENABLE.address] * PADDING, *block)
        addresses = b"".join(address.to_bytes(2, "little") for address in mapped)
        delay = round(self._settings.return_delay_s / tables.RETURN_DELAY_STEP_S)
        for servo_id in self.ids:
            write = self.registers.write_and_verify
            write(servo_id, tables.TORQUE_ENABLE, 0)
            write(servo_id, tables.RETURN_DELAY_TIME, delay, is_stored=True)
            what = "mapping its feedback to indirect data"
            self.registers.write_bytes(servo_id, tables.INDIRECT_ADDRESS, addresses, what)
            write(servo_id, tables.BUS_WATCHDOG, 0)  # clears a watchdog that has fired
            write(servo_id, tables.BUS_WATCHDOG, self._settings.watchdog)

    def prepare(self) -> None:
        """See `ServoLine.prepare`; current control as well."""
        self.prepare_feedback()
        for servo_id in self.ids:
            self.registers.write_and_verify(
                servo_id, tables.OPERATING_MODE, tables.CURRENT_CONTROL, is_stored=True
            )

    def switch_on(self) -> None:
        """Switch the torque on, at zero; raise `DeviceError`, with any hardware error, if a servo refused."""
        for servo_id in self.ids:
            self.registers.write_and_verify(servo_id, tables.GOAL_CURRENT, 0)
        for servo_id in self.ids:
            self.registers.write_and_verify(servo_id, tables.TORQUE_ENABLE, 1)

    @property
    def unreachable_note(self) -> str:
        after = f"{self._settings.watchdog_s:g} s after the last command"
        return f"the watchdog of each servo switches it off {after}"
