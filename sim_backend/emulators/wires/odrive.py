"""Emulated ODrive axes for an `odrive_bus`."""

from typing import Any, ClassVar

from robot_io.files.file_model import FileModel, Number, Positive, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.can import CanWire, EmulatedOdrive
from sim_backend.emulators.can.virtual_bus import open_virtual_bus
from sim_backend.emulators.wiring import WireMaker, WireRequest


class _Axis(FileModel, extra="ignore"):
    node_id: int
    gear_ratio: Positive = 1.0
    reversed: bool = False
    zero_rad: Number = 0.0
    max_torque_nm: Positive
    torque_constant_nm_a: Positive = 1.0


class _Settings(FileModel, extra="ignore"):
    firmware: str
    axes: tuple[_Axis, ...]
    heartbeat_s: Positive = 0.1
    watchdog_s: Positive = 0.1


class OdriveWires(WireMaker):
    """ODrive axes that are set up as the robot file says."""

    name: ClassVar[str] = "odrive_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        nodes = [
            EmulatedOdrive(
                axis.node_id,
                joint,
                request.plant,
                firmware=own.firmware,
                gear_ratio=-axis.gear_ratio if axis.reversed else axis.gear_ratio,
                zero_rad=axis.zero_rad,
                max_torque_nm=axis.max_torque_nm,
                torque_constant_nm_a=axis.torque_constant_nm_a,
                heartbeat_s=own.heartbeat_s,
                watchdog_s=own.watchdog_s,
            )
            for joint, axis in enumerate(own.axes)
        ]
        bus, reach = open_virtual_bus(in_lock_step=request.in_lock_step)
        return CanWire(bus, nodes, request.faults), reach
