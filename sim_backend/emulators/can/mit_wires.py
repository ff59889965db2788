"""Emulated MIT-mode motors for a `mit_bus`."""

from typing import Any

from robot_io.errors import InputError
from robot_io.files.file_model import FileModel, Positive, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.can import damiao_motor, mit_motor, robstride_motor
from sim_backend.emulators.can.damiao_motor import EmulatedDamiao
from sim_backend.emulators.can.mit_motor import EmulatedMitMotor, Limits
from sim_backend.emulators.can.motor import MotorPlace, wire_of
from sim_backend.emulators.can.robstride_motor import EmulatedRobstride
from sim_backend.emulators.plant import Plant
from sim_backend.emulators.wiring import WireMaker, WireRequest


class _Ranges(FileModel):
    position_rad: Positive
    velocity_rad_s: Positive
    torque_nm: Positive


class _Motor(MotorPlace):
    motor_id: int
    model: str
    ranges: _Ranges | None = None
    answer_id: int | None = None

    @property
    def limits(self) -> Limits:
        if self.ranges is not None:
            return (self.ranges.position_rad, self.ranges.velocity_rad_s, self.ranges.torque_nm)
        known = mit_motor.LIMITS | damiao_motor.LIMITS | robstride_motor.LIMITS
        if self.model not in known:
            raise InputError(f"no emulated motor is a '{self.model}'. Valid: {', '.join(known)}")
        return known[self.model]


class _Settings(FileModel, extra="ignore"):
    motors: tuple[_Motor, ...]
    maker: str = "cubemars"
    host_id: int | None = None
    watchdog_s: Positive = 0.1
    ask_with: str = "exit"


class MitWires(WireMaker):
    """Motors that are set up as the robot file says."""

    name = "mit_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        return wire_of(request, own.motors, lambda joint, motor: _emulated(own, motor, joint, request.plant))


def _emulated(own: _Settings, motor: _Motor, joint: int, plant: Plant) -> EmulatedMitMotor:
    place: tuple[int, int, Plant] = (motor.motor_id, joint, plant)
    mounting: dict[str, Any] = {"limits": motor.limits, **motor.mounting}
    if own.maker == "damiao":
        return EmulatedDamiao(*place, **mounting, host_id=motor.answer_id or motor.motor_id + 16)
    if own.maker == "robstride":
        host_id = robstride_motor.HOST if own.host_id is None else own.host_id
        return EmulatedRobstride(*place, **mounting, host_id=host_id)
    mounting |= {"timeout_s": own.watchdog_s, "deaf_when_off": own.ask_with == "enter"}
    return EmulatedMitMotor(*place, **mounting, host_id=own.host_id or 0)
