"""The calibrations that a robot file names: found, checked against the robot and the date, kept as text."""

from collections.abc import Collection
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import cos, sin

from robot_io.calibration.file import (
    CALIBRATION_KINDS,
    MAX_BYTES,
    Calibration,
    EncoderCalibration,
    ForceCalibration,
    GravityCalibration,
    TorqueCalibration,
    calibration_from,
)
from robot_io.calibration.identity import device_identity, first_difference, urdf_sha256
from robot_io.calibration.plausible import implausible
from robot_io.errors import InputError
from robot_io.files.file_model import input_error
from robot_io.files.safe_yaml import YamlDocument, load_yaml, parse_yaml
from robot_io.robot_file import RobotFile

GRAVITY_M_S2 = 9.81
_CLOCK_MAY_DIFFER = timedelta(days=1)


@dataclass(frozen=True)
class Calibrations:
    """What is applied to one robot; None where a device is taken as it is."""

    force: ForceCalibration | None = None  # of the force sensor
    encoder: EncoderCalibration | None = None  # of the joints' zeros
    torque: TorqueCalibration | None = None  # of the drives
    gravity: GravityCalibration | None = None  # of the base
    text: str = ""  # all of them in one YAML text, as a session keeps it; empty if there are none

    @property
    def kinds(self) -> tuple[str, ...]:
        """Those that there are."""
        return tuple(kind for kind in CALIBRATION_KINDS if getattr(self, kind) is not None)

    @property
    def gravity_base_m_s2(self) -> tuple[float, float, float]:
        """Fall acceleration in the base's axes [m/s^2]: g = R^T (0, 0, -9.81), R = R_y(pitch) R_x(roll)."""
        if self.gravity is None:
            return (0.0, 0.0, -GRAVITY_M_S2)
        values = self.gravity.values
        pitch, roll = (angle.value if angle else 0.0 for angle in (values.pitch, values.roll))
        return gravity_base_m_s2(pitch, roll)


NO_CALIBRATIONS = Calibrations()


def gravity_base_m_s2(pitch_rad: float, roll_rad: float) -> tuple[float, float, float]:
    """Fall acceleration in the axes of a base that is tilted; see `GravityValues` [m/s^2]."""
    across = GRAVITY_M_S2 * cos(pitch_rad)
    return (GRAVITY_M_S2 * sin(pitch_rad), -across * sin(roll_rad), -across * cos(roll_rad))


def load_calibrations(
    robot_file: RobotFile,
    now_utc: datetime | None = None,
    leave_out: Collection[str] = (),
    *,
    emulated: bool = False,
) -> Calibrations:
    """Those that the robot file names, each checked: it is of this robot and device, and has not expired.

    File names in its section `calibration` start from its folder. The date to hold them against is `now_utc`;
    None asks the machine's clock. Kinds to do without are left out, such as the one that is being calibrated.
    Where the devices are not emulated ones, a calibration of such says nothing of this robot.

    InputError: a file is not valid, foreign, expired, of emulated devices, or cannot be true of this arm.
    """
    now_utc = now_utc or datetime.now(UTC)
    found: dict[str, Calibration] = {}
    texts: list[str] = []
    for kind in CALIBRATION_KINDS:
        name = getattr(robot_file.calibration, kind)
        if name is None or kind in leave_out:
            continue
        document = _load(robot_file, kind, name)
        calibration = calibration_from(document)
        if problem := _objection(calibration, kind, robot_file, now_utc, emulated=emulated):
            raise input_error(robot_file.document, ("calibration", kind), f"'{name}' {problem}")
        found[kind] = calibration
        texts.append(_under(kind, document.text))
    return Calibrations(**found, text="".join(texts))  # type: ignore[arg-type]


def _load(robot_file: RobotFile, kind: str, name: str) -> YamlDocument:
    try:
        return load_yaml(robot_file.resolve(name), MAX_BYTES)
    except InputError as error:
        raise input_error(robot_file.document, ("calibration", kind), str(error)) from error


def parse_calibrations(text: str, origin: str = "calibration") -> Calibrations:
    """Those that a session was made with, from `Calibrations.text`; neither robot nor date are checked.

    InputError: the text is not valid.
    """
    document = parse_yaml(text, origin, len(CALIBRATION_KINDS) * MAX_BYTES * 2)
    strangers = [key for key in document.data if key not in CALIBRATION_KINDS]
    if strangers:
        raise InputError(
            f"{origin}: '{strangers[0]}' is no calibration. Valid: {', '.join(CALIBRATION_KINDS)}"
        )
    found = {kind: calibration_from(document, kind) for kind in document.data}
    return Calibrations(**found, text=text)  # type: ignore[arg-type]


def _objection(
    calibration: Calibration, kind: str, robot_file: RobotFile, now_utc: datetime, *, emulated: bool
) -> str | None:
    """Why this calibration must not be used, in words, or None."""
    if calibration.kind != kind:
        return f"is a calibration of kind '{calibration.kind}'"
    return (
        _foreign(calibration, robot_file)
        or (None if emulated else _not_of_real_devices(calibration))
        or _out_of_date(calibration, now_utc)
        or implausible(calibration, robot_file.limits)
    )


def _foreign(calibration: Calibration, robot_file: RobotFile) -> str | None:
    if calibration.robot != robot_file.name:
        return f"is for the robot '{calibration.robot:.60}', this is '{robot_file.name}'"
    if difference := first_difference(calibration.device, device_identity(robot_file, calibration.kind)):
        return f"is for another device: {difference}"
    if calibration.joint_count not in (None, robot_file.joint_count):
        return f"is for {calibration.joint_count} joints, the robot has {robot_file.joint_count}"
    if calibration.urdf_sha256 not in (None, urdf_sha256(robot_file)):
        return f"was made with another URDF than '{robot_file.urdf}' is now; {_again(calibration)}"
    if isinstance(calibration, ForceCalibration) and calibration.reading_unit != "N":
        said = f"is for readings in {calibration.reading_unit}, and the robot's driver gives N"
        return f"{said}; {_again(calibration)}, on the robot"
    return None


def _not_of_real_devices(calibration: Calibration) -> str | None:
    """A simulated robot's devices are told apart by their drivers, emulated ones by nothing but this."""
    if calibration.source == "emulated":
        return f"was made with emulated devices (--wire), not with the robot's own; {_again(calibration)}"
    if calibration.source is None:
        return f"does not say whether real devices were read ('source'); {_again(calibration)}"
    return None


def _out_of_date(calibration: Calibration, now_utc: datetime) -> str | None:
    if now_utc >= calibration.valid_until_utc:
        return f"expired on {calibration.valid_until_utc:%Y-%m-%d}; {_again(calibration)}"
    if now_utc + _CLOCK_MAY_DIFFER < calibration.made_utc:
        return f"was made on {calibration.made_utc:%Y-%m-%d}, after today ({now_utc:%Y-%m-%d}): set the clock"
    return None


def _again(calibration: Calibration) -> str:
    return f"make a new one: palpate calibrate {calibration.kind}"


def _under(kind: str, text: str) -> str:
    """A file's text as the value of a key."""
    return f"{kind}:\n" + "".join(f"  {line}\n" for line in text.splitlines())
