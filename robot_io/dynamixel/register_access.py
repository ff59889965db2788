"""Reading and writing single registers, with an answer or a named error: for setting up, not for ticks."""

from robot_io.clock import Clock
from robot_io.dynamixel import instructions
from robot_io.dynamixel.packet import StatusPacket, StatusReader
from robot_io.dynamixel.port import SerialPort
from robot_io.dynamixel.registers import HARDWARE_ERROR_STATUS, Register, hardware_error_names
from robot_io.errors import DeviceError, DeviceTimeoutError

_PATIENCE_S = 0.02  # beyond the time on the wire: USB adapters may hold bytes back for 16 ms
_PACKET = 12  # bytes of a packet around its data


class RegisterAccess:
    """One servo at a time: ask, wait for the answer, check it.

    Args:
        port: an open port.
        clock: for how long to wait.
    """

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        self._port = port
        self._clock = clock

    def ping(self, servo_id: int) -> tuple[int, int]:
        """Model number and firmware version.

        Raises:
            DeviceTimeoutError: nobody answers.
            DeviceError: the port failed, or the answer makes no sense.
        """
        packet = self._ask(servo_id, instructions.ping(servo_id), 3)
        self._check(packet, "ping")
        return packet.data[0] | packet.data[1] << 8, packet.data[2]

    def read(self, servo_id: int, register: Register) -> int:
        """The value of a register.

        Raises:
            DeviceTimeoutError: no answer.
            DeviceError: the port failed, or the servo refused.
        """
        request = instructions.read(servo_id, register.address, register.size)
        packet = self._ask(servo_id, request, register.size)
        self._check(packet, f"reading {register.name}")
        return register.decode(packet.data)

    def write(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register; the servo says that it has.

        Raises:
            DeviceTimeoutError: no answer.
            DeviceError: the port failed, or the servo refused, with its hardware error if it has one.
        """
        self.write_bytes(servo_id, register.address, register.encode(value), f"setting {register.name}")

    def write_bytes(self, servo_id: int, address: int, data: bytes, what: str) -> None:
        """Set bytes in a row; `what` is for the error.

        Raises:
            DeviceError: as `write`.
        """
        packet = self._ask(servo_id, instructions.write(servo_id, address, data), 0)
        self._check(packet, what)

    def settle(self, servo_id: int, register: Register, value: int, *, keeps: bool = False) -> None:
        """Set a register and read it back; one that keeps its value without power is only set if it differs.

        Raises:
            DeviceError: as `write`, or it has another value afterwards.
        """
        if keeps and self.read(servo_id, register) == value:
            return  # its memory wears out with each writing
        self.write(servo_id, register, value)
        self._confirm(servo_id, register, value)

    def insist(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register of a servo that may not answer to writing, and read it back.

        Raises:
            DeviceError: as `settle`.
        """
        self._port.write(instructions.write(servo_id, register.address, register.encode(value)))
        self._confirm(servo_id, register, value)

    def _confirm(self, servo_id: int, register: Register, value: int) -> None:
        found = self.read(servo_id, register)
        if found != value:
            raise DeviceError(f"servo {servo_id}: {register.name} is {found} after it was set to {value}")

    def _ask(self, servo_id: int, request: bytes, size: int) -> StatusPacket:
        self._port.discard()
        reader = StatusReader()
        self._port.write(request)
        wire_s = self._port.duration_s(len(request) + _PACKET + size)
        deadline_s = self._clock.now_s() + wire_s + _PATIENCE_S
        while True:
            for packet in reader.feed(self._port.wait(deadline_s)):
                if packet.servo_id == servo_id and (packet.refusal or len(packet.data) == size):
                    return packet
            if self._clock.now_s() >= deadline_s:
                damaged = f" ({reader.rejected} damaged answers)" if reader.rejected else ""
                raise DeviceTimeoutError(f"servo {servo_id}: no answer{damaged}")

    def _check(self, packet: StatusPacket, what: str) -> None:
        if not packet.refusal:
            return
        problem = f"servo {packet.servo_id}: {what}: {packet.refusal}"
        if packet.alert:
            found = self._ask(
                packet.servo_id,
                instructions.read(packet.servo_id, HARDWARE_ERROR_STATUS.address, HARDWARE_ERROR_STATUS.size),
                HARDWARE_ERROR_STATUS.size,
            )
            names = hardware_error_names(HARDWARE_ERROR_STATUS.decode(found.data))
            problem += f" (hardware error: {names}; it must be rebooted)"
        raise DeviceError(problem)
