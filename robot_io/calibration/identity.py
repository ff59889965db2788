"""What tells one device from another: its driver and those settings that its readings depend on."""

import hashlib
from collections.abc import Mapping

from robot_io.errors import InputError
from robot_io.robot_file import DeviceSection, RobotFile

# Settings that say when a sample comes or is refused, not what it is; a calibration outlives their change.
_PASSING = frozenset(
    {
        *("scenario", "baud_rate", "delay_s", "return_delay_s", "watchdog_s"),
        *("heartbeat_s", "fast_sync_read", "velocity", "bandwidth_hz", "pair_tolerance_rad"),
    }
)


def device_identity(robot_file: RobotFile, kind: str) -> dict[str, object]:
    """The device that a calibration of this kind is of: driver, settings, and the same of its bus.

    Gravity is felt by the drives.
    """
    key = "torque" if kind == "gravity" else kind
    section: DeviceSection = getattr(robot_file, key)
    identity: dict[str, object] = {"driver": section.driver, **_lasting(section.settings)}
    if section.bus is not None:
        bus = robot_file.buses[section.bus]
        identity["bus"] = {"driver": bus.driver, **_lasting(bus.settings)}
    return identity


def first_difference(wanted: Mapping[str, object], found: Mapping[str, object], at: str = "") -> str | None:
    """The first setting in which two identities differ, in words, or None."""
    for key in (*wanted, *(key for key in found if key not in wanted)):
        one, other = wanted.get(key), found.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            if inner := first_difference(one, other, f"{at}{key}."):
                return inner
        elif one != other:
            return f"{at}{key} was {one!r:.60} and is {other!r:.60}"
    return None


def urdf_sha256(robot_file: RobotFile) -> str:
    """Of the robot's URDF. InputError: it cannot be read."""
    try:
        return hashlib.sha256(robot_file.urdf_path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{robot_file.urdf_path}: cannot be read ({error.strerror})") from error


def _lasting(settings: Mapping[str, object]) -> dict[str, object]:
    return {key: value for key, value in settings.items() if key not in _PASSING}
