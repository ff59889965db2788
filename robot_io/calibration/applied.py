"""Load the calibrations that a robot file names, check them, and apply them to its devices.

A calibration belongs to a device: its driver and those settings that affect its readings. It acts between the
sensors and the guard. A wrong calibration must neither hide forces nor command more than a drive may exert.

A calibrated device wraps a driver and corrects its readings and commands. This module alone applies
calibrations between driver and `Measurement` or `Command`. Samples keep their time and status; NaN stays NaN.
"""

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import cos, sin
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from palpate.robot_io.calibration.file import (
    CALIBRATION_KINDS,
    MAX_BYTES,
    Calibration,
    EncoderCalibration,
    ForceCalibration,
    GravityCalibration,
    TorqueCalibration,
    calibration_from,
)
from palpate.robot_io.errors import InputError
from palpate.robot_io.examination import Examinable, Finding
from palpate.robot_io.files.file_model import input_error, load_yaml, parse_yaml
from palpate.robot_io.guard import Limits
from palpate.robot_io.interfaces import Component, ForceSensor, JointEncoder, JointTorque
from palpate.robot_io.robot_file import DeviceSection, RobotFile
from palpate.robot_io.types import FloatArray, Reading, frozen_array

# Settings that affect a sample's time or rejection, but not its value; they may change after a calibration.
_SETTINGS_OUTSIDE_IDENTITY = frozenset(
    {
        *("scenario", "baud_rate", "delay_s", "return_delay_s", "watchdog_s"),
        *("heartbeat_s", "fast_sync_read", "velocity", "bandwidth_hz", "pair_tolerance_rad"),
    }
)


def device_identity(robot_file: RobotFile, kind: str) -> dict[str, object]:
    """Return driver and settings of a calibration's device, with its bus; gravity belongs to the drives.

    Args:
        robot_file: robot with the device.
        kind: kind of the calibration.
    """
    key = "torque" if kind == "gravity" else kind
    section: DeviceSection = getattr(robot_file, key)
    identity: dict[str, object] = {"driver": section.driver, **_identifying_settings(section.settings)}
    if section.bus is not None:
        bus = robot_file.buses[section.bus]
        identity["bus"] = {"driver": bus.driver, **_identifying_settings(bus.settings)}
    return identity


def first_difference(
    expected: Mapping[str, object], actual: Mapping[str, object], at: str = ""
) -> str | None:
    """Return key and values of the first setting in which two identities differ; None if they are equal.

    Args:
        expected: identity in the calibration.
        actual: identity of the robot.
        at: prefix of the keys.
    """
    for key in (*expected, *(key for key in actual if key not in expected)):
        before, now = expected.get(key), actual.get(key)
        if isinstance(before, Mapping) and isinstance(now, Mapping):
            if inner := first_difference(before, now, f"{at}{key}."):
                return inner
        elif before != now:
            return f"{at}{key} was {before!r:.60} and is {now!r:.60}"
    return None


def urdf_sha256(robot_file: RobotFile) -> str:
    """Return the SHA-256 of the robot's URDF; raise `InputError` if the URDF cannot be read.

    Args:
        robot_file: names the URDF.
    """
    try:
        return hashlib.sha256(robot_file.urdf_path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{robot_file.urdf_path}: cannot be read ({error.strerror})") from error


def _identifying_settings(settings: Mapping[str, object]) -> dict[str, object]:
    return {key: value for key, value in settings.items() if key not in _SETTINGS_OUTSIDE_IDENTITY}


_ZERO_SHARE = 0.5  # largest zero, as a share of the force limit
_SLOPE_SHARE = 0.5  # smallest slope up to the force limit, as a share of the scale
_OFFSET_SHARE = 0.2  # largest offset, as a share of the torque limit
_LARGE_ZERO_SHIFT_RAD = 0.2


def _implausible_value(calibration: Calibration, limits: Limits) -> str | None:
    """Describe the first value of a calibration that cannot belong to this arm; None if there is none."""
    if isinstance(calibration, ForceCalibration):
        values, limit_n = calibration.values, limits.force_n
        scale = values.scale.value
        zero_n, most_n = abs(values.zero.value) * scale, _ZERO_SHARE * limit_n
        under = f"with a force limit of {limit_n:g} N"
        if zero_n > most_n:
            return f"has a zero offset of {zero_n:.3g} N; {under}, at most {most_n:.3g} N is allowed"
        # With the most negative curvature that is allowed, this reading above zero is the force limit; the
        # curve falls below the limit again only at three times this reading.
        reading_at_limit = 2.0 * limit_n / (scale * (1.0 + _SLOPE_SHARE))
        curvature = values.curvature.value if values.curvature else 0.0
        most = (1.0 - _SLOPE_SHARE) * scale / (2.0 * reading_at_limit)
        if abs(curvature) > most:
            return (
                f"has a curvature of {curvature:.3g} N/N^2, which hides forces from the guard; {under}, "
                f"at most {most:.3g} N/N^2 is allowed"
            )
    elif isinstance(calibration, TorqueCalibration):
        for name in ("offset", "command_offset"):
            offsets_nm = getattr(calibration.values, name).value
            for joint, (offset_nm, limit_nm) in enumerate(zip(offsets_nm, limits.torque_nm, strict=True), 1):
                most_nm = _OFFSET_SHARE * limit_nm
                if abs(offset_nm) > most_nm:
                    return (
                        f"has a {name} of {offset_nm:.3g} N m for joint {joint}; with a torque limit "
                        f"of {limit_nm:g} N m, at most {most_nm:.3g} N m is allowed"
                    )
    return None


def find_large_zero_shift(calibration: Calibration) -> str | None:
    """Describe large shifts of joint zeros, which a person must confirm; None if there are none.

    Any zero is possible, but with a wrong zero the arm moves to unexpected places. A large shift usually
    means that the arm was in another pose, or at another stop, than stated.

    Args:
        calibration: calibration of any kind.
    """
    if not isinstance(calibration, EncoderCalibration):
        return None
    offsets = enumerate(calibration.values.offset.value, 1)
    far = [f"joint {k} by {by:+.3g} rad" for k, by in offsets if abs(by) > _LARGE_ZERO_SHIFT_RAD]
    if not far:
        return None
    return (
        f"it shifts the zero of {', '.join(far)}, more than {_LARGE_ZERO_SHIFT_RAD:g} rad. Was the arm "
        "really in the stated pose? With a wrong zero, the arm can move beyond its limits"
    )


GRAVITY_M_S2 = 9.81
_CLOCK_TOLERANCE = timedelta(minutes=5)  # by which the clocks of two machines may differ


@dataclass(frozen=True)
class Calibrations:
    """Calibrations of one robot; None for a device without calibration."""

    force: ForceCalibration | None = None  # of the force sensor
    encoder: EncoderCalibration | None = None  # of the joints' zeros
    torque: TorqueCalibration | None = None  # of the drives
    gravity: GravityCalibration | None = None  # of the base
    text: str = ""  # all calibrations in one YAML text, as in a session; empty if there are none

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the calibrations that are present."""
        return tuple(kind for kind in CALIBRATION_KINDS if getattr(self, kind) is not None)

    @property
    def gravity_base_m_s2(self) -> tuple[float, float, float]:
        """Gravity vector in the base's axes [m/s^2]: g = R^T (0, 0, -9.81), R = R_y(pitch) R_x(roll)."""
        if self.gravity is None:
            return (0.0, 0.0, -GRAVITY_M_S2)
        values = self.gravity.values
        pitch, roll = (angle.value if angle else 0.0 for angle in (values.pitch, values.roll))
        return gravity_base_m_s2(pitch, roll)


def gravity_base_m_s2(pitch_rad: float, roll_rad: float) -> tuple[float, float, float]:
    """Compute the gravity vector in the axes of a tilted base, shape (3,) [m/s^2]; see `GravityValues`.

    Args:
        pitch_rad: pitch about the base's y axis [rad].
        roll_rad: roll about the base's x axis [rad].
    """
    across = GRAVITY_M_S2 * cos(pitch_rad)
    return (GRAVITY_M_S2 * sin(pitch_rad), -across * sin(roll_rad), -across * cos(roll_rad))


def load_calibrations(
    robot_file: RobotFile,
    now_utc: datetime | None = None,
    leave_out: Collection[str] = (),
    *,
    emulated: bool = False,
) -> Calibrations:
    """Load the calibrations that a robot file names, each checked against robot, device and date.

    File names in its section `calibration` are relative to its folder.

    Args:
        robot_file: names the files.
        now_utc: date for the check; None for the machine's clock.
        leave_out: kinds that are not loaded, such as the one that is being calibrated.
        emulated: whether the devices are emulated; if not, a calibration of emulated devices is rejected.

    Raises:
        InputError: a file is invalid, foreign, expired, of emulated devices, or implausible for this arm.
    """
    now_utc = now_utc or datetime.now(UTC)
    calibrations: dict[str, Calibration] = {}
    texts: list[str] = []
    for kind in CALIBRATION_KINDS:
        name = getattr(robot_file.calibration, kind)
        if name is None or kind in leave_out:
            continue
        try:
            document = load_yaml(robot_file.resolve(name), MAX_BYTES)
        except InputError as error:
            raise input_error(robot_file.document, ("calibration", kind), str(error)) from error
        calibration = calibration_from(document)
        if problem := _reject_reason(calibration, kind, robot_file, now_utc, emulated=emulated):
            raise input_error(robot_file.document, ("calibration", kind), f"'{name}' {problem}")
        calibrations[kind] = calibration
        texts.append(f"{kind}:\n" + "".join(f"  {line}\n" for line in document.text.splitlines()))
    return Calibrations(**calibrations, text="".join(texts))  # type: ignore[arg-type]


def parse_calibrations(text: str, origin: str = "calibration") -> Calibrations:
    """Read `Calibrations.text` of a session, without checks of robot and date, or raise `InputError`.

    Args:
        text: YAML.
        origin: name of the text in errors.
    """
    document = parse_yaml(text, origin, len(CALIBRATION_KINDS) * MAX_BYTES * 2)
    unknown = [key for key in document.data if key not in CALIBRATION_KINDS]
    if unknown:
        raise InputError(
            f"{origin}: '{unknown[0]}' is not a kind of calibration. Valid: {', '.join(CALIBRATION_KINDS)}"
        )
    calibrations = {kind: calibration_from(document, kind) for kind in document.data}
    return Calibrations(**calibrations, text=text)  # type: ignore[arg-type]


def _reject_reason(
    calibration: Calibration, kind: str, robot_file: RobotFile, now_utc: datetime, *, emulated: bool
) -> str | None:
    """Describe why this calibration must not be used, or return None."""
    remedy = f"make a new one: palpate calibrate {calibration.kind}"
    unit = getattr(calibration, "reading_unit", "N")
    difference = first_difference(calibration.device, device_identity(robot_file, calibration.kind))
    # Calibrations of simulated devices name other drivers, so that `difference` rejects them.
    is_foreign_emulation = not emulated and calibration.source == "emulated"
    made, until = calibration.made_utc, calibration.valid_until_utc
    reasons = (
        (calibration.kind != kind, f"is a calibration of kind '{calibration.kind}'"),
        (
            calibration.robot != robot_file.name,
            f"is for the robot '{calibration.robot:.60}', but this is '{robot_file.name}'",
        ),
        (difference, f"is for a different device: {difference}"),
        (
            calibration.joint_count not in (None, robot_file.joint_count),
            f"is for {calibration.joint_count} joints, but the robot has {robot_file.joint_count}",
        ),
        (
            calibration.urdf_sha256 not in (None, urdf_sha256(robot_file)),
            f"was made with a URDF other than the present '{robot_file.urdf}'; {remedy}",
        ),
        (unit != "N", f"is for readings in {unit}, but the robot's driver gives N; {remedy}, on the robot"),
        (
            is_foreign_emulation,
            f"was made with emulated devices (--wire), not with the robot's own; {remedy}",
        ),
        (
            not emulated and calibration.source is None,
            f"does not state its 'source', so it may have been made with emulated devices; {remedy}",
        ),
        (now_utc >= until, f"expired on {until:%Y-%m-%d}; {remedy}"),
        (
            now_utc + _CLOCK_TOLERANCE < made,
            f"was made on {made.astimezone(UTC):%Y-%m-%d at %H:%M} UTC, later than now "
            f"({now_utc.astimezone(UTC):%Y-%m-%d at %H:%M}); set the clock",
        ),
    )
    reason = next((text for holds, text in reasons if holds), None)
    return reason or _implausible_value(calibration, robot_file.limits)


Driver = TypeVar("Driver", bound=Component)


class _Calibrated(Component, Examinable, Generic[Driver]):
    """Forwards lifecycle and examination to the driver."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    def configure(self) -> None:
        self._driver.configure()

    def activate(self) -> None:
        self._driver.activate()

    def verify(self) -> None:
        self._driver.verify()

    def deactivate(self) -> None:
        self._driver.deactivate()

    def close(self) -> None:
        self._driver.close()

    def examine(self) -> tuple[Finding, ...]:
        """See `Examinable.examine`; empty for a driver without examination."""
        return self._driver.examine() if isinstance(self._driver, Examinable) else ()

    def tick_wire_s(self) -> float | None:
        return self._driver.tick_wire_s() if isinstance(self._driver, Examinable) else None


class CalibratedForceSensor(_Calibrated[ForceSensor], ForceSensor):
    """Force sensor with force = scale (reading - zero) + curvature (reading - zero)^2."""

    def __init__(self, driver: ForceSensor, calibration: ForceCalibration) -> None:
        super().__init__(driver)
        values = calibration.values
        self._zero, self._scale = values.zero.value, values.scale.value
        self._curvature = values.curvature.value if values.curvature else 0.0

    def read_force(self) -> Reading:
        value, sampled_at_s, status, _ = self._driver.read_force()
        above = value - self._zero
        return Reading(above * (self._scale + self._curvature * above), sampled_at_s, status)


class CalibratedEncoder(_Calibrated[JointEncoder], JointEncoder):
    """Encoder with position = reading + offset; the velocity is unchanged."""

    def __init__(self, driver: JointEncoder, calibration: EncoderCalibration) -> None:
        super().__init__(driver)
        self._offset_rad = frozen_array(calibration.values.offset.value)

    @property
    def joint_count(self) -> int:
        return self._driver.joint_count

    def read_position(self) -> Reading:
        value, sampled_at_s, status, _ = self._driver.read_position()
        return Reading(value + self._offset_rad, sampled_at_s, status)

    def read_velocity(self) -> Reading:
        return self._driver.read_velocity()


class CalibratedTorque(_Calibrated[JointTorque], JointTorque):
    """Drive with torque = gain reading + offset; its command is (torque - command offset) / gain.

    A command never exceeds `limit_nm` (n), even if the calibration enlarges a torque. A zero torque is
    commanded as the value that gives zero torque by the calibration.
    """

    def __init__(self, driver: JointTorque, calibration: TorqueCalibration, limit_nm: ArrayLike) -> None:
        super().__init__(driver)
        values = calibration.values
        self._gain = frozen_array(values.gain.value)
        self._offset_nm = frozen_array(values.offset.value)
        self._command_offset_nm = frozen_array(values.command_offset.value)
        self._limit_nm = frozen_array(limit_nm, self._gain.shape, what="torque limit")

    @property
    def joint_count(self) -> int:
        return self._driver.joint_count

    def read_torque(self) -> Reading:
        value, sampled_at_s, status, saturated = self._driver.read_torque()
        return Reading(self._gain * value + self._offset_nm, sampled_at_s, status, saturated)

    def stage_torque(self, torque_nm: FloatArray) -> FloatArray:
        """See `JointTorque.stage_torque`; argument and return value are true torques."""
        command_nm = (torque_nm - self._command_offset_nm) / self._gain
        staged_nm = self._driver.stage_torque(command_nm.clip(-self._limit_nm, self._limit_nm))
        return np.asarray(self._gain * staged_nm + self._command_offset_nm)
