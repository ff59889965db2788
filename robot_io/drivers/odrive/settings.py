"""What a robot file says of ODrive axes on a CAN bus."""

from typing import Annotated

from pydantic import Field, model_validator

from robot_io.drivers.can.line import CanLineSettings
from robot_io.drivers.can.motors import MotorMounting
from robot_io.drivers.odrive.protocol import MAX_NODE_ID, Firmware
from robot_io.files.file_model import Positive, TorqueConstant
from robot_io.guard.limits import Torque


class OdriveAxis(MotorMounting):
    """One axis."""

    node_id: Annotated[int, Field(ge=0, le=MAX_NODE_ID, strict=True)]  # its CAN node id
    max_torque_nm: Torque  # largest motor torque, from its current limit [N m]
    # What lets it exert that [A]. If stated, each activation writes it to the axis, with a velocity limit
    # that leaves room beyond this file's (Set_Limits); else both are as they were set over USB.
    current_limit_a: Annotated[Positive, Field(le=1000)] | None = None
    # Motor torque per ampere, needed with firmware 0.5, which reports current [N m/A].
    torque_constant_nm_a: TorqueConstant | None = None


class OdriveBusSettings(CanLineSettings):
    """What the robot file says."""

    firmware: Firmware  # "0.5" or "0.6"
    axes: Annotated[tuple[OdriveAxis, ...], Field(min_length=1)]  # one per joint, from base to tip
    heartbeat_s: Annotated[Positive, Field(le=1)] = 0.1  # period of the heartbeats [s]
    # After how long without a command an axis disarms itself [s], as set on the axis. Every watchdog is left
    # to expire once at each activation, to see that it works.
    watchdog_s: Annotated[Positive, Field(le=1)] = 0.1

    @model_validator(mode="after")
    def _agree(self) -> "OdriveBusSettings":
        ids = [axis.node_id for axis in self.axes]
        if len(set(ids)) != len(ids):
            raise ValueError(f"axes: node ids {ids} are not all different")
        if self.firmware is Firmware.V0_5 and any(axis.torque_constant_nm_a is None for axis in self.axes):
            raise ValueError(
                "axes: firmware 0.5 reports current, so that each needs its torque_constant_nm_a"
            )
        return self
