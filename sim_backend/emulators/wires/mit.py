"""Emulated MIT-mode motors for a `mit_bus`."""

from typing import Any, ClassVar

from robot_io.errors import InputError
from robot_io.files.file_model import FileModel, Number, Positive, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.can import CanWire, EmulatedMitMotor
from sim_backend.emulators.can.virtual_bus import open_virtual_bus
from sim_backend.emulators.wiring import WireMaker, WireRequest

# CubeMars "AK Series Actuator Driver Manual" V1.0.8, 5.3: position [rad], speed [rad/s], torque [N m].
LIMITS = {
    "AK10-9": (12.5, 50.0, 65.0),
    "AK60-6": (12.5, 45.0, 15.0),
    "AK70-10": (12.5, 50.0, 25.0),
    "AK80-6": (12.5, 76.0, 12.0),
    "AK80-9": (12.5, 50.0, 18.0),
    "AK80-64": (12.5, 8.0, 144.0),
    "AK80-80": (12.5, 8.0, 144.0),
}


class _Ranges(FileModel):
    position_rad: Positive
    velocity_rad_s: Positive
    torque_nm: Positive


class _Motor(FileModel, extra="ignore"):
    motor_id: int
    model: str
    gear_ratio: Positive = 1.0
    reversed: bool = False
    zero_rad: Number = 0.0
    ranges: _Ranges | None = None

    @property
    def limits(self) -> tuple[float, float, float]:
        if self.ranges is not None:
            return (self.ranges.position_rad, self.ranges.velocity_rad_s, self.ranges.torque_nm)
        if self.model not in LIMITS:
            raise InputError(f"no emulated motor is a '{self.model}'. Valid: {', '.join(LIMITS)}")
        return LIMITS[self.model]


class _Settings(FileModel, extra="ignore"):
    motors: tuple[_Motor, ...]
    host_id: int = 0
    watchdog_s: Positive = 0.1
    ask_with: str = "exit"


class MitWires(WireMaker):
    """Motors that are set up as the robot file says."""

    name: ClassVar[str] = "mit_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        nodes = [
            EmulatedMitMotor(
                motor.motor_id,
                joint,
                request.plant,
                limits=motor.limits,
                gear_ratio=-motor.gear_ratio if motor.reversed else motor.gear_ratio,
                zero_rad=motor.zero_rad,
                host_id=own.host_id,
                timeout_s=own.watchdog_s,
                deaf_when_off=own.ask_with == "enter",
            )
            for joint, motor in enumerate(own.motors)
        ]
        bus, reach = open_virtual_bus(in_lock_step=request.in_lock_step)
        return CanWire(bus, nodes, request.faults), reach
