"""The operator's device, by its name or from a YAML file: `device: NAME`, and its settings beside it."""

from pathlib import Path

from control.teleop.operator_devices import OPERATOR_DEVICES, build_operator_device
from robot_io.clock import Clock
from robot_io.errors import InputError
from robot_io.files.safe_yaml import load_yaml
from robot_io.operator.device import OperatorDevice

_DEVICE = "device"


def build_operator(operator: str, clock: Clock) -> OperatorDevice:
    """Make the device; opens nothing yet.

    Args:
        operator: a device's name, or a file.
        clock: what its samples are stamped with.

    Raises:
        InputError: there is no such device or file, or a setting is not valid.
    """
    if operator in OPERATOR_DEVICES:
        return build_operator_device(operator, {}, clock)
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
