"""Every operator device that there is, by name; a new one is one new file in `robot_io.operator`."""

from collections.abc import Mapping

from robot_io.clock import Clock
from robot_io.files.file_model import validate
from robot_io.files.safe_yaml import YamlDocument
from robot_io.operator.device import OperatorDevice
from robot_io.registry import Registry

# The leader arm needs kinematics, which `robot_io` does not know.
_PLACES = ("robot_io.operator", "control.teleop.leader_arm")

OPERATOR_DEVICES = Registry("operator device", OperatorDevice, *_PLACES)  # type: ignore[type-abstract]


def build_operator_device(
    name: str,
    settings: Mapping[str, object],
    clock: Clock,
    document: YamlDocument | None = None,
) -> OperatorDevice:
    """Make the device `name`; opens nothing yet.

    Args:
        name: one of `OPERATOR_DEVICES`.
        settings: as its `Settings` want them.
        clock: what samples are stamped with.
        document: where the settings come from, for file and line in errors; None if made by a program.

    Raises:
        UnknownNameError: no device has this name.
        InputError: a setting is not valid.
    """
    device = OPERATOR_DEVICES[name]
    return device(validate(device.Settings, settings, document), clock)
