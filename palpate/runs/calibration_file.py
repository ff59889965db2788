"""Check recorded sessions and make calibration files from them."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

import numpy as np
import yaml

from palpate.calibration.arm_fit import ArmFit, GravityBodies, fit_arm, motion_of
from palpate.calibration.encoder import EncoderFit, fit_pose, fit_stops
from palpate.calibration.force import ForceFit
from palpate.calibration.standstill import UncertainValue
from palpate.common import console
from palpate.common.console import FIRST_PROBE, display_path, safe, shell_path
from palpate.common.files import open_session
from palpate.control.loop.tick_record import STREAM_NAME
from palpate.estimation.data.tick_channels import checked_ticks
from palpate.robot_io.calibration.applied import (
    device_identity,
    first_difference,
    parse_calibrations,
    urdf_sha256,
)
from palpate.robot_io.calibration.file import (
    Calibration,
    EncoderCalibration,
    ForceCalibration,
    GravityCalibration,
    RawData,
    TorqueCalibration,
)
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import validate
from palpate.robot_io.robot_file import RobotFile, parse_robot_file
from palpate.robot_io.session import Session
from palpate.robot_io.types import FloatArray
from palpate.runs.calibration import KIND
from palpate.runs.options import RunOptions
from palpate.runs.robots import EMULATED, is_simulated, shipped_robots
from palpate.runs.session import SOURCE

_FAMILY = {"gravity": "torque"}  # kinds that accept each other's sessions


def open_recorded(path: Path, kind: str, robot_file: RobotFile) -> Session:
    """Open a session that was recorded for a calibration of this kind and robot.

    Args:
        path: session file.
        kind: kind of the calibration.
        robot_file: robot file of the robot to calibrate.

    Raises:
        InputError: the session was recorded for another kind, robot or device, or with such a calibration
            applied.
    """
    session = open_session(path)
    made_for = session.metadata.extra.get(KIND)
    if made_for is None or _FAMILY.get(made_for, made_for) != _FAMILY.get(kind, kind):
        made = f"palpate calibrate {made_for}" if made_for else "no calibration"
        raise InputError(f"session {path}: is from {made}; palpate calibrate {kind} cannot use it")
    recorded = parse_robot_file(session.metadata.robot_file, robot_file.path)
    if recorded.name != robot_file.name:
        raise InputError(
            f"session {path}: belongs to the robot '{recorded.name}', not '{robot_file.name}' (see --robot)"
        )
    if changed := first_difference(device_identity(recorded, kind), device_identity(robot_file, kind)):
        raise InputError(f"session {path}: was recorded with another device: {changed}")
    if kind in parse_calibrations(session.metadata.calibration, f"{path}, its calibration").kinds:
        raise InputError(
            f"session {path}: its readings were already corrected by a calibration of kind '{kind}'"
        )
    if STREAM_NAME in session.stream_names:
        checked_ticks(session)
    return session


@dataclass(frozen=True)
class CalibrationStamp:
    """Origin of a calibration, which every calibration file states."""

    robot_file: RobotFile  # robot file of the calibrated robot
    raw: Path  # session or data file of the fit
    now_utc: datetime  # date of the calibration
    valid_days: float  # validity of the calibration [days]
    source: str | None = "measured"  # or simulated, or emulated
    made_with: tuple[str, ...] = ()  # calibrations applied during the recording

    @classmethod
    def of(cls, robot_file: RobotFile, raw: Path, valid_days: float) -> "CalibrationStamp":
        """Read the origin from a session; a data file states none and counts as measured now.

        Args:
            robot_file: robot file of the robot to calibrate.
            raw: session or data file.
            valid_days: validity of the calibration [days].
        """
        if raw.suffix != ".mcap":
            return cls(robot_file, raw, datetime.now(UTC), valid_days)
        metadata = Session.open(raw).metadata
        recorded = metadata.extra.get(SOURCE)
        known = {EMULATED: "emulated", "measured": "measured", "simulated": "simulated"}
        source = known.get(recorded or "")
        names = [line.rstrip(":") for line in metadata.calibration.splitlines() if line[:1].strip()]
        made_utc = datetime.fromisoformat(metadata.created_utc)
        return cls(robot_file, raw, made_utc, valid_days, source, tuple(names))

    def content(self, kind: str) -> dict[str, object]:
        """Return all fields except the values; raise `InputError` if the raw data or URDF cannot be read.

        Args:
            kind: kind of the calibration.
        """
        with self.raw.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        content: dict[str, object] = {
            "palpate_calibration": 1,
            "kind": kind,
            "robot": self.robot_file.name,
            "device": device_identity(self.robot_file, kind),
            "source": self.source,
            "made_utc": self.now_utc.isoformat(timespec="seconds"),
            "valid_until_utc": (self.now_utc + timedelta(days=self.valid_days)).isoformat(timespec="seconds"),
            "software_version": version("palpate"),
            "raw_data": RawData(file=self.raw.name, sha256=sha256).model_dump(),
            "made_with": self.made_with,
        }
        if kind in ("torque", "gravity"):
            content["urdf_sha256"] = urdf_sha256(self.robot_file)
        return content


def arm_fit_of(session: Session, urdf: str | Path, tip_frame: str) -> ArmFit:
    """Fit gains, offsets, friction and tilt to a session of `run_motion`.

    Args:
        session: session of the motion.
        urdf: file with the arm's masses.
        tip_frame: frame of the tip in the URDF.

    Raises:
        InputError: the session is of another kind, or does not determine a joint's gain.
    """
    return fit_arm(motion_of(session.samples(STREAM_NAME)), GravityBodies.from_urdf(urdf, tip_frame))


def encoder_fit_of(
    session: Session, joint_count: int, pose_rad: Sequence[float] | None, known_std_rad: float
) -> EncoderFit:
    """Fit encoder zeros to a session of `run_stops` or `run_pose`; raise `InputError` for another session.

    Args:
        session: session of the stops or of the pose.
        joint_count: number of joints of the arm.
        pose_rad: pose in which the arm was held, shape (n,) [rad]; None if stops were touched.
        known_std_rad: standard uncertainty of stops or pose [rad].
    """
    if pose_rad is not None:
        return fit_pose(session, np.array(pose_rad, dtype=np.float64), known_std_rad)
    try:
        return fit_stops(session, joint_count, known_std_rad)
    except InputError as error:
        raise InputError(f"{error}; if the arm was held in a pose, give it with --pose") from error


def force_calibration(fit: ForceFit, reading_unit: str, stamp: CalibrationStamp) -> ForceCalibration:
    """Make the content of a force calibration.

    Args:
        fit: scale, zero and curvature.
        reading_unit: unit of the sensor's readings.
        stamp: origin of the calibration.
    """
    values = {"zero": _entry(fit.zero, reading_unit), "scale": _entry(fit.scale, f"N/{reading_unit}")}
    if fit.curvature:
        values["curvature"] = _entry(fit.curvature, f"N/{reading_unit}^2")
    findings = {
        "hysteresis": _entry(fit.hysteresis_n, "N"),
        "nonlinearity": _entry(fit.nonlinearity, "1"),
        "residual_rms": _entry(UncertainValue(fit.rms_n, 0.0), "N"),
        "range": _entry(UncertainValue(list(fit.range_n), [0.0, 0.0]), "N"),
    }
    content = stamp.content("force") | {"reading_unit": reading_unit, "values": values, "findings": findings}
    return validate(ForceCalibration, content)


def encoder_calibration(fit: EncoderFit, stamp: CalibrationStamp) -> EncoderCalibration:
    """Make the content of an encoder calibration.

    Args:
        fit: the joints' zeros.
        stamp: origin of the calibration.
    """
    values = {"offset": _entry(UncertainValue(fit.offset_rad, fit.std_rad), "rad")}
    findings = {"repeatability": _exact(fit.repeatability_rad, "rad")}
    return validate(EncoderCalibration, stamp.content("encoder") | {"values": values, "findings": findings})


def torque_calibration(fit: ArmFit, stamp: CalibrationStamp) -> TorqueCalibration:
    """Make the content of a torque calibration; friction is reported, not applied.

    Args:
        fit: gains and offsets of the drives.
        stamp: origin of the calibration.
    """
    values = {
        "gain": _entry(fit.gain, "1"),
        "offset": _entry(fit.offset_nm, "N m"),
        "command_offset": _entry(fit.command_offset_nm, "N m"),
    }
    findings = {
        "coulomb_friction": _entry(fit.coulomb_nm, "N m"),
        "viscous_friction": _entry(fit.viscous_nms_rad, "N m s/rad"),
        "residual_rms": _exact(_rms(fit.residual_nm), "N m"),
    }
    return validate(TorqueCalibration, stamp.content("torque") | {"values": values, "findings": findings})


def gravity_calibration(fit: ArmFit, stamp: CalibrationStamp) -> GravityCalibration:
    """Make the content of a gravity calibration, without angles that do not affect the arm's torques.

    Args:
        fit: tilt of the base.
        stamp: origin of the calibration.

    Raises:
        InputError: no tilt affects the arm's torques.
    """
    tilt = zip(("pitch", "roll"), fit.tilt_rad.value.tolist(), fit.tilt_rad.std_err.tolist(), strict=True)
    values = {
        name: _entry(UncertainValue(angle, std), "rad") for name, angle, std in tilt if np.isfinite(angle)
    }
    if not values:
        raise InputError("no joint of this arm carries weight: the tilt of its base cannot be measured")
    findings = {
        "torque_gain": _entry(fit.gain, "1"),
        "coulomb_friction": _entry(fit.coulomb_nm, "N m"),
        "residual_rms": _exact(_rms(fit.residual_nm), "N m"),
    }
    return validate(GravityCalibration, stamp.content("gravity") | {"values": values, "findings": findings})


def _rms(residual: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.nanmean(residual**2, axis=0)))


def _exact(values: FloatArray, unit: str) -> dict[str, object]:
    return _entry(UncertainValue(values, np.zeros_like(values)), unit)


def _entry(
    estimate: UncertainValue[FloatArray] | UncertainValue[float] | UncertainValue[list[float]], unit: str
) -> dict[str, object]:
    value, std_err = (np.asarray(part).tolist() for part in (estimate.value, estimate.std_err))
    return {"value": value, "std_err": std_err, "unit": unit}


def print_usage_hint(calibration: Calibration, path: Path, options: RunOptions) -> None:
    """Print on stderr the lines to add to the robot file, and the next command.

    Args:
        calibration: the calibration.
        path: its file.
        options: options that name the robot.
    """
    talk, robot_file = console.stderr(), options.robot_file
    file, is_shipped = robot_file.path, options.robot in shipped_robots()
    unit = getattr(calibration, "reading_unit", "N")
    if unit != "N":
        talk.print(
            f"\nIt calibrates readings in {unit}. A robot file cannot use it, because a robot's "
            "driver reads N."
        )
        again = f"palpate calibrate force {options.robot_words} --weights-kg 0,0.5,1,2,1,0.5,0"
        console.next_steps((again, "calibrate the sensor as the robot reads it"))
        return
    if is_shipped:
        talk.print(f"\nTo use it, copy the shipped arm, and write into the copy's {safe(file.name)}:")
    else:
        talk.print(f"\nTo use it, write into {display_path(file)}:", soft_wrap=True)
    named = {kind: name for kind, name in robot_file.calibration.model_dump().items() if name is not None}
    folder = file.resolve().parent
    named[calibration.kind] = str(path.relative_to(folder) if path.is_relative_to(folder) else path)
    line = yaml.safe_dump(named, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10_000)
    talk.print(f"  calibration: {safe(line.strip())}", soft_wrap=True)
    wire = " --wire" if calibration.source == "emulated" else ""
    if wire:
        talk.print("It was made with emulated devices: use it with --wire; a real arm refuses it.")
    if is_shipped:
        copy = Path(f"my_{options.robot}")
        console.next_steps(
            (f"cp -r {shell_path(file.parent)} {copy}", "copy the arm's files, to change them"),
            (f"palpate probe --robot {copy / file.name}", "probe with it, once the robot file names it"),
        )
        return
    gentle = "" if is_simulated(robot_file) else f" {FIRST_PROBE}"
    console.next_steps(
        (f"palpate probe {options.robot_words}{wire}{gentle}", "probe with it, once the robot file names it")
    )
