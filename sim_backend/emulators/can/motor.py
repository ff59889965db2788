"""What emulated motors on a CAN bus share: how they move a joint, and what their own sensors show."""

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from robot_io.files.file_model import FileModel, Number, Positive
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.can.wire import CanNode, CanWire, open_virtual_bus
from sim_backend.emulators.faults import Fault, FaultKind
from sim_backend.emulators.plant import JointState, Plant
from sim_backend.emulators.wiring import WireRequest


class MotorPlace(FileModel, extra="ignore"):
    """What a robot file says of how any motor moves its joint."""

    gear_ratio: Positive = 1.0
    reversed: bool = False
    zero_rad: Number = 0.0

    @property
    def mounting(self) -> dict[str, float]:
        """For an emulated motor."""
        return {
            "gear_ratio": -self.gear_ratio if self.reversed else self.gear_ratio,
            "zero_rad": self.zero_rad,
        }


class EmulatedMotor(CanNode):
    """One motor, by its id; it moves a joint of the plant, from 0.

    Its shaft turns `gear_ratio` times for one turn of the joint, negative if it is reversed, and is at zero
    where the joint is at `zero_rad` [rad].
    """

    def __init__(
        self, number: int, joint: int, plant: Plant, *, gear_ratio: float = 1.0, zero_rad: float = 0.0
    ) -> None:
        self.number = number
        self._joint, self._plant, self._gear_ratio, self._zero_rad = joint, plant, gear_ratio, zero_rad
        self._heard_s = self._silent_until_s = -math.inf
        self._stuck: JointState | None = None

    @property
    def shaft(self) -> JointState:
        """Angle, speed and torque of its shaft as they are."""
        return self._at_shaft(self._plant.joint(self._joint))

    @property
    def shown(self) -> JointState:
        """The same, as its encoder shows them."""
        return self._at_shaft(self._stuck or self._plant.joint(self._joint))

    def _at_shaft(self, motion: JointState) -> JointState:
        torque_nm = self._plant.joint(self._joint).torque_nm  # which no encoder measures
        ratio = self._gear_ratio
        angle_rad = (motion.position_rad - self._zero_rad) * ratio
        return JointState(angle_rad, motion.velocity_rad_s * ratio, torque_nm / ratio)

    def _exert(self, shaft_nm: float) -> None:
        self._plant.set_torque(self._joint, shaft_nm * self._gear_ratio)

    def strike(self, fault: Fault, now_s: float) -> None:
        if fault.kind is FaultKind.ALERT:
            self._fail()
        elif fault.kind is FaultKind.STUCK:
            self._stuck = self._stuck or self._plant.joint(self._joint)
        elif fault.kind is FaultKind.REBOOT:
            self._start_up()
            self._silent_until_s = now_s + fault.delay_s
        self._drive()

    @abstractmethod
    def _fail(self) -> None:
        """Have an error of its own."""

    @abstractmethod
    def _start_up(self) -> None:
        """Be as after power-up."""

    @abstractmethod
    def _drive(self) -> None:
        """Exert what it has been told, if it does."""


def wire_of(
    request: WireRequest, motors: Sequence[Any], make: Callable[[int, Any], CanNode]
) -> tuple[EmulatedWire, dict[str, Any]]:
    """A bus with a node for each of `motors`, made from its joint and its settings; see `WireMaker.make`."""
    nodes = [make(joint, motor) for joint, motor in enumerate(motors)]
    bus, reach = open_virtual_bus(in_lock_step=request.in_lock_step)
    return CanWire(bus, nodes, request.faults), reach
