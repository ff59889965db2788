"""Connects emulated devices to every bus of a robot file, for tests of the real drivers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, ClassVar

from palpate.robot_io.clock import Clock, SimulatedClock
from palpate.robot_io.driver import SettingsModel
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import validate
from palpate.robot_io.registry import Registry
from palpate.robot_io.robot_file import DeviceSection, RobotFile, replace_data
from palpate.sim_backend.emulators.faults import Faults
from palpate.sim_backend.emulators.hardware import EmulatedWire, HardwareEmulator, Plant
from palpate.sim_backend.scenario import Scenario


@dataclass(frozen=True)
class WireRequest:
    """The bus that an emulated wire replaces.

    An emulator reads settings by the driver's model, but draws no conclusion from them by the driver's code.
    """

    robot_file: RobotFile  # the arm
    bus: str  # name of the bus
    plant: Plant  # the world with the arm
    faults: Faults  # what goes wrong on this wire
    start_s: float  # time on the emulator's clock [s]
    in_lock_step: bool  # whether the clock is a simulated one

    def settings_as(self, model: type[SettingsModel]) -> SettingsModel:
        """Validate the settings of the bus.

        Args:
            model: the driver's model.

        Raises:
            InputError: a setting is invalid.
        """
        section = self.robot_file.buses[self.bus]
        return validate(model, section.settings, self.robot_file.document, ("buses", self.bus))

    def force_settings_as(self, model: type[SettingsModel]) -> SettingsModel:
        """Validate the settings of the force sensor; see `settings_as`."""
        return validate(model, self.robot_file.force.settings, self.robot_file.document, ("force",))

    @property
    def force(self) -> DeviceSection | None:
        """The force sensor in the robot file; None if it is not on this bus."""
        force = self.robot_file.force
        return force if force.bus == self.bus else None

    def refusal(self, problem: str) -> InputError:
        """Make the error for a bus that cannot be emulated.

        Args:
            problem: description.
        """
        return InputError(f"{self.robot_file.path}, bus '{self.bus}': {problem}")


class WireMaker(ABC):
    """Makes the emulated wire of the bus driver of the same name; found by a registry, one per file."""

    name: ClassVar[str]

    @abstractmethod
    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        """Make the wire, and the bus settings by which its driver finds it.

        Args:
            request: the bus to emulate.

        Raises:
            InputError: the settings are not valid.
        """


@dataclass(frozen=True)
class WiredArm:
    """A robot file whose buses lead to emulated devices."""

    robot_file: RobotFile  # the same arm, with the ports of the emulators
    plant: Plant  # the world behind them
    emulator: HardwareEmulator  # advances time; `start` it on a real clock, `close` it at the end
    wires: Mapping[str, EmulatedWire]  # the emulated wires by bus name


WIRE_MAKERS = Registry("emulated bus", WireMaker, "palpate.sim_backend.emulators")  # type: ignore[type-abstract]
"""All wires that can be emulated, by the name of the bus driver."""


def wire_up(
    robot_file: RobotFile, scenario: Scenario, clock: Clock, faults: Mapping[str, Faults] | None = None
) -> WiredArm:
    """Emulate every bus of a robot; on a simulated clock the devices run in lockstep with it.

    Args:
        robot_file: robot file of the real arm.
        scenario: the simulated world.
        clock: simulated, or a real one.
        faults: faults by bus name.

    Returns:
        The arm with its emulator, which the caller closes.

    Raises:
        InputError: a bus has no emulator, or its settings are not valid.
    """
    unknown = [section.driver for section in robot_file.buses.values() if section.driver not in WIRE_MAKERS]
    if unknown:
        raise InputError(f"{robot_file.path}: {WIRE_MAKERS.unknown(unknown[0])}")
    start_s = clock.now_s()
    plant = Plant(robot_file, scenario, start_s)
    data = deepcopy(robot_file.document.data)
    wires: dict[str, EmulatedWire] = {}
    try:
        for bus, section in robot_file.buses.items():
            wire_faults = (faults or {}).get(bus) or Faults(start_s=start_s)
            in_lock_step = isinstance(clock, SimulatedClock)
            request = WireRequest(robot_file, bus, plant, wire_faults, start_s, in_lock_step)
            wires[bus], reach = WIRE_MAKERS[section.driver]().make(request)
            data["buses"][bus].update(reach)  # type: ignore[index]
        wired_file = replace_data(robot_file, data)
    except InputError:
        for wire in wires.values():
            wire.close()
        plant.close()
        raise
    return WiredArm(wired_file, plant, HardwareEmulator(plant, list(wires.values()), clock), wires)
