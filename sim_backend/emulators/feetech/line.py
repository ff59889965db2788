"""What STS servos of a line answer to instructions."""

from collections.abc import Sequence
from typing import Any

from robot_io.files.file_model import FileModel, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.faults import Faults
from sim_backend.emulators.feetech import wire
from sim_backend.emulators.feetech.servo import EmulatedSts, Mounting
from sim_backend.emulators.plant import Plant
from sim_backend.emulators.servo_wire import Answer, Frame, ServoWire, on_shafts
from sim_backend.emulators.wiring import WireMaker, WireRequest

_GOAL = 42
_PING, _READ, _WRITE, _SYNC_READ, _SYNC_WRITE = 0x01, 0x02, 0x03, 0x82, 0x83


class FeetechLine(ServoWire):
    """Servos of one line, see `ServoWire`.

    Each turns the joint at its place in the list, with its second one; those of the ids `hold` turn nothing.
    `echoes` is whether the adapter hears what it says, as some do.
    """

    _status = staticmethod(wire.status)

    def __init__(
        self,
        mountings: Sequence[Mounting],
        plant: Plant,
        faults: Faults | None = None,
        *,
        hold: Sequence[int] = (),
        baud_rate: int | None = 1_000_000,
        start_s: float = 0.0,
    ) -> None:
        holding = [(Mounting(id=one, model=mountings[0].model), None) for one in hold]
        self.servos = {
            mounting.id: EmulatedSts(mounting, shaft, start_s)
            for mounting, shaft in (*on_shafts(mountings, plant), *holding)
        }
        super().__init__(self.servos, faults, baud_rate, start_s)
        self._receiver = wire.Receiver()
        self.echoes = False

    def _hear(self, data: bytes, now_s: float) -> None:
        if self.echoes and data:
            self._outgoing.append(Frame(0, data, now_s))
        for instruction in self._receiver.take(data):
            self._quiet_s = now_s + self._byte_s * instruction.wire_bytes
            awake = {number: servo for number, servo in self.servos.items() if servo.is_awake(now_s)}
            if instruction.target == wire.BROADCAST:
                self._obey_all(instruction, awake, now_s)
            elif instruction.target in awake:
                self._obey(instruction, awake[instruction.target], now_s)

    def _obey(self, instruction: wire.Instruction, servo: EmulatedSts, now_s: float) -> None:
        code, parameters = instruction.code, instruction.parameters
        if code == _READ and len(parameters) == 2:
            self._answer([Answer(servo, servo.read(*parameters))], now_s)
        elif code == _PING:
            self._answer([Answer(servo)], now_s)
        elif code == _WRITE and len(parameters) > 1:
            servo.write(parameters[0], parameters[1:])
            if servo.get(8, 1):
                self._answer([Answer(servo)], now_s)

    def _obey_all(self, instruction: wire.Instruction, awake: dict[int, EmulatedSts], now_s: float) -> None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            self._answer((Answer(servo) for _, servo in sorted(awake.items())), now_s)
        elif code == _SYNC_READ:
            address, size, *asked = parameters
            heard = [awake[one] for one in asked if one in awake]
            self._answer((Answer(servo, servo.read(address, size)) for servo in heard), now_s)
        elif code == _SYNC_WRITE:
            address, size = parameters[:2]
            for start in range(2, len(parameters) - size, size + 1):
                servo = awake.get(parameters[start])
                if servo is not None and not (servo.deaf and address == _GOAL):
                    servo.write(address, parameters[start + 1 : start + 1 + size])


class _Settings(FileModel, extra="ignore"):
    servos: tuple[Mounting, ...]
    hold: tuple[int, ...] = ()
    baud_rate: int = 1_000_000


class FeetechWires(WireMaker):
    """Servos that are set up as the robot file says, on a pseudo terminal."""

    name = "feetech_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        line = FeetechLine(
            own.servos,
            request.plant,
            request.faults,
            hold=own.hold,
            baud_rate=own.baud_rate,
            start_s=request.start_s,
        )
        return line, {"port": line.path}
