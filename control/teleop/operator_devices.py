"""Registry of operator devices; a new one is one new file in `palpate.robot_io.operator`."""

from collections.abc import Mapping
from pathlib import Path

from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import YamlDocument, load_yaml, validate
from palpate.robot_io.operator.device import OperatorDevice
from palpate.robot_io.registry import Registry

# The leader arm needs kinematics, which `robot_io` does not know.
_PLACES = ("palpate.robot_io.operator", "palpate.control.teleop.leader_arm")

OPERATOR_DEVICES = Registry("operator device", OperatorDevice, *_PLACES)  # type: ignore[type-abstract]
_DEVICE = "device"  # key of a file that names one, with its settings beside it


def build_operator_device(
    name: str,
    settings: Mapping[str, object],
    clock: Clock,
    document: YamlDocument | None = None,
) -> OperatorDevice:
    """Make an operator device; opens nothing yet.

    Args:
        name: of the device.
        settings: for its `Settings`.
        clock: of this side.
        document: that the settings come from, for errors with file and line.

    Returns:
        The device.

    Raises:
        UnknownNameError: no device has this name.
        InputError: a setting is invalid.
    """
    device = OPERATOR_DEVICES[name]
    return device(validate(device.Settings, settings, document), clock)


def build_operator(operator: str, clock: Clock) -> OperatorDevice:
    """Make an operator device from a name or a YAML file; opens nothing yet.

    Args:
        operator: name of a device, or path of a file that names one and holds its settings.
        clock: of this side.

    Returns:
        The device.

    Raises:
        InputError: there is no such device or file, or a setting is invalid.
    """
    if operator in OPERATOR_DEVICES:
        try:
            return build_operator_device(operator, {}, clock)
        except InputError as error:
            how = f"give a YAML file with '{_DEVICE}: {operator}' and its settings"
            raise InputError(f"operator '{operator}': {error}; {how}") from error
    valid = ", ".join(OPERATOR_DEVICES)
    if not Path(operator).is_file():
        raise InputError(f"operator '{operator}': no such file, and the devices are {valid}")
    document = load_yaml(operator)
    settings = document.data
    name = settings.get(_DEVICE) if isinstance(settings, dict) else None
    if not isinstance(settings, dict) or not isinstance(name, str) or name not in OPERATOR_DEVICES:
        raise InputError(f"{operator}: '{_DEVICE}' must name one of {valid}")
    rest = {key: value for key, value in settings.items() if key != _DEVICE}
    return build_operator_device(name, rest, clock, document)
