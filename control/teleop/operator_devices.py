"""Every operator device that there is, by name; a new one is one new file in `robot_io.operator`."""

from collections.abc import Mapping
from pathlib import Path

from robot_io.clock import Clock
from robot_io.errors import InputError
from robot_io.files.file_model import validate
from robot_io.files.safe_yaml import YamlDocument, load_yaml
from robot_io.operator.device import OperatorDevice
from robot_io.registry import Registry

# The leader arm needs kinematics, which `robot_io` does not know.
_PLACES = ("robot_io.operator", "control.teleop.leader_arm")

OPERATOR_DEVICES = Registry("operator device", OperatorDevice, *_PLACES)  # type: ignore[type-abstract]
_DEVICE = "device"  # key of a file that names one, with its settings beside it


def build_operator_device(
    name: str,
    settings: Mapping[str, object],
    clock: Clock,
    document: YamlDocument | None = None,
) -> OperatorDevice:
    """Make the device `name` with what its `Settings` want; opens nothing yet.

    UnknownNameError: no device has this name; InputError: a setting is not valid, with file and line if the
    settings come from a document.
    """
    device = OPERATOR_DEVICES[name]
    return device(validate(device.Settings, settings, document), clock)


def build_operator(operator: str, clock: Clock) -> OperatorDevice:
    """Make the device that a name or a YAML file says; opens nothing yet.

    InputError: there is no such device or file, or a setting is not valid.
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
