"""Construction of drivers: their context, and the catalog of all drivers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar, cast

from pydantic import BaseModel

from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import PalpateError, describe_error
from palpate.robot_io.files.file_model import KeyPath, input_error, validate
from palpate.robot_io.interfaces import Bus, Component, ForceSensor, JointEncoder, JointTorque
from palpate.robot_io.registry import Registry
from palpate.robot_io.robot_file import RobotFile

BUILT_IN_DRIVERS = "palpate.robot_io.drivers"

SettingsModel = TypeVar("SettingsModel", bound=BaseModel)
BusType = TypeVar("BusType", bound=Bus)
ComponentType = TypeVar("ComponentType", bound=Component)


@dataclass(frozen=True, slots=True)
class DriverContext:
    """Context of a driver, in addition to its settings."""

    clock: Clock  # the robot's clock; samples are stamped with it
    robot_file: RobotFile  # the whole robot file, for joint count, limits and paths
    bus: Bus | None = None  # bus of the device, or None
    section: KeyPath = ()  # path of the driver's settings in the robot file, for errors

    def settings_as(self, model: type[SettingsModel], settings: Mapping[str, object]) -> SettingsModel:
        """Validate the driver's settings; raise `InputError` with file, line, key, value and valid values.

        Args:
            model: the driver's own pydantic model.
            settings: section of the robot file.
        """
        return validate(model, settings, self.robot_file.document, self.section)

    def bus_as(self, bus_type: type[BusType]) -> BusType:
        """Return the device's bus; raise `InputError` if it has none, or one of another class.

        Args:
            bus_type: class that the bus must have.
        """
        if isinstance(self.bus, bus_type):
            return self.bus
        name = getattr(bus_type, "name", bus_type.__name__)
        problem = f"must name a bus whose driver is '{name}'"
        raise input_error(self.robot_file.document, (*self.section, "bus"), problem)


class DriverCatalog:
    """All drivers that a robot file can name, by kind.

    A driver is a class in a module of one of the packages. It derives from an interface, states a `name`, and
    is made by `Driver(settings: Mapping[str, object], context: DriverContext)`; making it opens nothing.

    Args:
        packages: packages that are searched in addition to the built-in drivers.
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

    Args:
        registry: registry of the driver's kind.
        driver: name of the driver.
        settings: settings of the driver.
        context: clock, robot file and bus.

    Raises:
        InputError: no driver has this name, its settings are invalid, or its own code fails.
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
        problem = f"the driver cannot be created: {describe_error(error)}"
        raise input_error(context.robot_file.document, place, problem, driver) from error
