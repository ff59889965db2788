"""Robot file: one YAML file that describes an arm's parts and limits."""

import math
import os.path
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, PrivateAttr, field_validator

from palpate.robot_io.files.file_model import (
    MAX_TEXT_BYTES,
    FileModel,
    NotNegative,
    Number,
    YamlDocument,
    input_error,
    load_yaml,
    matching,
    parse_yaml,
    validate,
)
from palpate.robot_io.guard import Limits, SafeState

Name = Annotated[
    str,
    matching(
        r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,63}",
        "1 to 64 letters, digits, _ . or -, starting with a letter or digit",
    ),
]
Text = Annotated[str, Field(min_length=1)]


_SLOWEST_RAD_S2 = 1.0  # least acceleration by a joint's torque limit


class BusSection(FileModel):
    """A bus: its driver, and settings that the driver itself checks."""

    model_config = ConfigDict(extra="allow")

    driver: Name

    @property
    def settings(self) -> Mapping[str, object]:
        """Settings for the driver."""
        return self.model_extra or {}


class DeviceSection(BusSection):
    """A device: its driver, its bus (None: none), and the driver's own settings."""

    bus: str | None = None


class CalibrationSection(FileModel):
    """Files of calibrations, relative to the robot file; None: the device is used uncalibrated."""

    force: Text | None = None  # scale and zero of the force sensor
    encoder: Text | None = None  # zeros of the joints
    torque: Text | None = None  # gains and offsets of the drives
    gravity: Text | None = None  # how the base stands


class RobotFile(FileModel):
    """Content of a robot file. Lists hold one value per joint, from base to tip."""

    name: Name  # short name of the arm
    urdf: Text  # URDF file, relative to the robot file
    dh: Text | None = None  # DH table, relative to the robot file, or None
    tip_frame: Text  # URDF frame at the force sensor's contact point
    # Unit vector in the tip frame along which the tool pushes; force is positive in compression along it.
    sensor_axis_tip: tuple[Number, Number, Number]
    control_rate_hz: Annotated[Number, Field(ge=20, le=20_000)]  # ticks per second [Hz]
    buses: dict[str, BusSection] = Field(default_factory=dict)  # buses by name
    encoder: DeviceSection  # joint encoders
    torque: DeviceSection  # torque-controlled drives
    force: DeviceSection  # force sensor
    # Inertia of the drives' rotors times the square of the gear ratio, which a URDF cannot hold; with gears
    # of some hundred to one, most of a joint's inertia [kg m^2].
    rotor_inertia_kg_m2: tuple[NotNegative, ...] | None = None
    # Pose in which the arm can rest, tool down; it is never driven there. Shape (n,) [rad].
    home_rad: Annotated[tuple[Number, ...], Field(min_length=1)]
    limits: Limits  # of the guard
    safe_state: SafeState  # how the guard stops the arm
    gains: dict[str, Any] = Field(default_factory=dict)  # controller gains; the controllers check them
    # Files of calibrations; see `palpate.robot_io.calibration`.
    calibration: CalibrationSection = CalibrationSection()

    _document: YamlDocument = PrivateAttr()

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self.home_rad)

    @property
    def path(self) -> Path:
        """Path of the file, or the one it had when its text was stored."""
        return Path(self._document.origin)

    @property
    def text(self) -> str:
        """The file as it was written, even if its data were replaced, as for emulated devices."""
        return self._document.text

    @property
    def document(self) -> YamlDocument:
        """The file with its line numbers, for errors about what a driver or controller reads from it."""
        return self._document

    @property
    def urdf_path(self) -> Path:
        """The URDF file."""
        return self.resolve(self.urdf)

    def resolve(self, relative: str) -> Path:
        """Resolve a path in this file.

        Args:
            relative: path relative to the folder of the robot file; an absolute path is not changed.
        """
        return self.path.parent / relative

    @field_validator("sensor_axis_tip")
    @classmethod
    def _make_unit(cls, axis: tuple[float, float, float]) -> tuple[float, ...]:
        length = math.hypot(*axis)
        if not 1e-6 < length < 1e6:
            raise ValueError("has no direction")
        return tuple(component / length for component in axis)


def load_robot_file(path: str | Path) -> RobotFile:
    """Read and check a robot file: the files it names exist, and no port is named twice.

    Args:
        path: path of the file.

    Raises:
        InputError: the first problem, with file, line, key, value and valid values.
    """
    robot_file = _from_document(load_yaml(path))
    for key in ("urdf", "dh"):
        name = getattr(robot_file, key)
        if name is not None and not os.path.isfile(robot_file.resolve(name)):
            raise input_error(robot_file.document, (key,), f"no such file: {robot_file.resolve(name)}")
        if name is not None and os.path.getsize(robot_file.resolve(name)) > MAX_TEXT_BYTES:
            raise input_error(robot_file.document, (key,), f"larger than {MAX_TEXT_BYTES} bytes", name)
    # Refuse two buses with the same serial port, also under different names.
    taken: dict[str, str] = {}
    for name, bus in robot_file.buses.items():
        port = bus.settings.get("port")
        if not isinstance(port, str) or not port.startswith("/") or "\0" in port:
            continue
        first = taken.setdefault(os.path.realpath(port), name)
        if first != name:
            problem = f"is also the port of '{first}'; give each bus its own port"
            raise input_error(robot_file.document, ("buses", name, "port"), problem, port)
    return robot_file


def parse_robot_file(text: str, origin: str | Path) -> RobotFile:
    """Read a robot file from its text, for instance the copy in a session; other files are not checked.

    Args:
        text: YAML.
        origin: name of the text in errors.

    Raises:
        InputError: as for `load_robot_file`.
    """
    return _from_document(parse_yaml(text, str(origin)))


def replace_data(robot_file: RobotFile, data: dict[str, object]) -> RobotFile:
    """Return a copy of a robot file with other data; the text is unchanged, and errors cite its lines.

    Args:
        robot_file: the original.
        data: all sections, as in `robot_file.document.data`.

    Raises:
        InputError: as for `parse_robot_file`.
    """
    return _from_document(replace(robot_file.document, data=data))


def _from_document(document: YamlDocument) -> RobotFile:
    robot_file = validate(RobotFile, document.data, document)
    robot_file._document = document
    count = robot_file.joint_count
    for key_path, values in (
        (("limits", "torque_nm"), robot_file.limits.torque_nm),
        (("safe_state", "damping_nms_rad"), robot_file.safe_state.damping_nms_rad),
        (("rotor_inertia_kg_m2",), robot_file.rotor_inertia_kg_m2 or (0.0,) * count),
    ):
        if len(values) != count:
            problem = f"has {len(values)} values, but home_rad has {count}; give one per joint"
            raise input_error(robot_file.document, key_path, problem, list(values))
    for joint, inertia in enumerate(robot_file.rotor_inertia_kg_m2 or ()):
        largest = robot_file.limits.torque_nm[joint] / _SLOWEST_RAD_S2
        if inertia > largest:
            problem = (
                f"give 0 to {largest:g} kg m2; with a larger inertia, the torque limit takes over 1 s to "
                "accelerate the joint to 1 rad/s"
            )
            raise input_error(robot_file.document, ("rotor_inertia_kg_m2", joint), problem, inertia)
    limits = robot_file.limits
    for joint, home in enumerate(robot_file.home_rad):
        low, high = limits.position_min_rad[joint], limits.position_max_rad[joint]
        if not low <= home <= high:
            problem = f"joint {joint + 1} is outside its position limits {low} to {high}"
            raise input_error(robot_file.document, ("home_rad", joint), problem, home)
    for key in ("encoder", "torque", "force"):
        bus = getattr(robot_file, key).bus
        if bus is not None and bus not in robot_file.buses:
            valid = ", ".join(robot_file.buses) or "(none: 'buses' is empty)"
            raise input_error(robot_file.document, (key, "bus"), f"is not in 'buses'. Valid: {valid}", bus)
    return robot_file
