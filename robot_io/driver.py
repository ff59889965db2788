"""How drivers are found and put together: what each is given, and the catalogue of all of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar, cast

from pydantic import BaseModel

from robot_io.clock import Clock
from robot_io.errors import PalpateError, in_words
from robot_io.files.file_model import input_error, validate
from robot_io.files.safe_yaml import KeyPath
from robot_io.interfaces import Bus, Component, ForceSensor, JointEncoder, JointTorque
from robot_io.registry import Registry
from robot_io.robot_file import RobotFile

BUILT_IN_DRIVERS = "robot_io.drivers"

SettingsModel = TypeVar("SettingsModel", bound=BaseModel)
BusType = TypeVar("BusType", bound=Bus)
ComponentType = TypeVar("ComponentType", bound=Component)


@dataclass(frozen=True, slots=True)
class DriverContext:
    """What a driver is given beside its settings."""

    clock: Clock  # the robot's clock; samples are stamped with it
    robot_file: RobotFile  # the whole robot file, for joint count, limits and paths
    bus: Bus | None = None  # the bus that the device hangs on, or None
    section: KeyPath = ()  # where in the robot file the driver's settings stand, for errors

    def settings_as(self, model: type[SettingsModel], settings: Mapping[str, object]) -> SettingsModel:
        """The driver's settings as its own pydantic model.

        InputError: with file, line, key, value and the valid choices.
        """
        return validate(model, settings, self.robot_file.document, self.section)

    def bus_as(self, bus_type: type[BusType]) -> BusType:
        """The device's bus, which must be a `bus_type`.

        InputError: there is none, or it is of another kind.
        """
        if isinstance(self.bus, bus_type):
            return self.bus
        wanted = getattr(bus_type, "name", bus_type.__name__)
        problem = f"must name a bus whose driver is '{wanted}'"
        raise input_error(self.robot_file.document, (*self.section, "bus"), problem)


class DriverCatalogue:
    """Every driver that a robot file can name, by kind: the built-in ones, and those in further `packages`.

    A driver is a class in a module of one of the packages. It derives from an interface, states a `name`, and
    is made by `Driver(settings: Mapping[str, object], context: DriverContext)`; making it opens nothing.
    """

    def __init__(self, *packages: str) -> None:
        names = tuple(dict.fromkeys((BUILT_IN_DRIVERS, *packages)))
        self.bus = Registry("bus driver", Bus, *names)  # type: ignore[type-abstract]
        self.encoder = Registry("encoder driver", JointEncoder, *names)  # type: ignore[type-abstract]
        self.torque = Registry("torque driver", JointTorque, *names)  # type: ignore[type-abstract]
        self.force = Registry("force sensor driver", ForceSensor, *names)  # type: ignore[type-abstract]


def make_driver(
    registry: Registry[ComponentType], driver: str, settings: Mapping[str, object], context: DriverContext
) -> ComponentType:
    """Make the driver that the robot file names in `context.section`.

    InputError: no driver has this name, its settings are not valid, or its own code fails.
    """
    place = (*context.section, "driver")
    if driver not in registry:
        raise input_error(context.robot_file.document, place, registry.unknown(driver))
    make = cast("Callable[[Mapping[str, object], DriverContext], ComponentType]", registry[driver])
    try:
        return make(settings, context)
    except PalpateError:
        raise
    except Exception as error:
        problem = f"the driver cannot be made, {in_words(error)}"
        raise input_error(context.robot_file.document, place, problem, driver) from error
