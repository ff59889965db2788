"""Emulated Dynamixel servos for a `dynamixel_bus`."""

from typing import Any, ClassVar

from robot_io.files.file_model import FileModel, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.dynamixel import DynamixelLine, Mounting
from sim_backend.emulators.wiring import WireMaker, WireRequest


class _Settings(FileModel, extra="ignore"):
    servos: tuple[Mounting, ...]
    baud_rate: int = 4_000_000


class DynamixelWires(WireMaker):
    """Servos that are set up as the robot file says, on a pseudo terminal."""

    name: ClassVar[str] = "dynamixel_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        line = DynamixelLine(
            own.servos, request.plant, request.faults, baud_rate=own.baud_rate, start_s=request.start_s
        )
        return line, {"port": line.path}
