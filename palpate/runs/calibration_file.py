"""Check recorded sessions and make calibration files from them."""

import hashlib
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import ArrayLike

from palpate.calibration.arm_fit import ArmFit
from palpate.calibration.encoder import EncoderFit
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
from palpate.robot_io.calibration.file import CALIBRATIONS, Calibration
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
        raise InputError(f"session {path}: was recorded with a different device: {changed}")
    if kind in parse_calibrations(session.metadata.calibration, f"{path}, its calibration").kinds:
        raise InputError(
            f"session {path}: its readings were already corrected by a calibration of kind '{kind}'; record "
            "a session without this calibration"
        )
    if STREAM_NAME in session.stream_names:
        checked_ticks(session)
    return session


def make_calibration(
    kind: str,
    fit: ArmFit | EncoderFit | ForceFit,
    robot_file: RobotFile,
    raw: Path,
    valid_days: float,
    *,
    reading_unit: str = "N",
) -> Calibration:
    """Make the content of a calibration file; friction is reported, not applied.

    A session states its origin; a data file states none and counts as measured now. A tilt that does not
    affect the arm's torques is left out.

    Args:
        kind: kind of the calibration.
        fit: result of the kind's fit.
        robot_file: robot file of the calibrated robot.
        raw: session or data file of the fit.
        valid_days: validity of the calibration [days].
        reading_unit: unit of the force sensor's readings.

    Raises:
        InputError: the raw data or URDF cannot be read, or no tilt affects the arm's torques.
    """
    with raw.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    made_utc, made_with = datetime.now(UTC), list[str]()
    source: str | None = "measured"
    if raw.suffix == ".mcap":
        metadata = Session.open(raw).metadata
        made_utc, made_by = datetime.fromisoformat(metadata.created_utc), metadata.extra.get(SOURCE)
        source = "emulated" if made_by == EMULATED else made_by
        made_with = [line.rstrip(":") for line in metadata.calibration.splitlines() if line[:1].strip()]
    values, findings = _results(kind, fit, reading_unit)
    content: dict[str, object] = {
        "palpate_calibration": 1,
        "kind": kind,
        "robot": robot_file.name,
        "device": device_identity(robot_file, kind),
        "source": source if source in ("measured", "simulated", "emulated") else None,
        "made_utc": made_utc.isoformat(timespec="seconds"),
        "valid_until_utc": (made_utc + timedelta(days=valid_days)).isoformat(timespec="seconds"),
        "software_version": version("palpate"),
        "raw_data": {"file": raw.name, "sha256": sha256},
        "made_with": tuple(made_with),
        "values": values,
        "findings": findings,
    }
    if kind == "force":
        content["reading_unit"] = reading_unit
    if kind in ("torque", "gravity"):
        content["urdf_sha256"] = urdf_sha256(robot_file)
    return validate(CALIBRATIONS[kind], content)


def _results(
    kind: str, fit: ArmFit | EncoderFit | ForceFit, reading_unit: str
) -> tuple[dict[str, dict[str, object]], dict[str, dict[str, object]]]:
    """Return the values and the findings of a fit."""
    if isinstance(fit, ForceFit):
        values = {"zero": _entry(fit.zero, reading_unit), "scale": _entry(fit.scale, f"N/{reading_unit}")}
        if fit.curvature:
            values["curvature"] = _entry(fit.curvature, f"N/{reading_unit}^2")
        drift = {} if fit.drift_n is None else {"drift": _entry(fit.drift_n, "N")}
        return values, drift | {
            "hysteresis": _entry(fit.hysteresis_n, "N"),
            "nonlinearity": _entry(fit.nonlinearity, "1"),
            "residual_rms": _exact(fit.rms_n, "N"),
            "range": _exact(fit.range_n, "N"),
        }
    if isinstance(fit, EncoderFit):
        values = {"offset": _entry(UncertainValue(fit.offset_rad, fit.std_rad), "rad")}
        return values, {"repeatability": _exact(fit.repeatability_rad, "rad")}
    rms_nm = _exact(np.sqrt(np.nanmean(fit.residual_nm**2, axis=0)), "N m")
    coulomb = _entry(fit.coulomb_nm, "N m")
    if kind == "torque":
        values = {
            "gain": _entry(fit.gain, "1"),
            "offset": _entry(fit.offset_nm, "N m"),
            "command_offset": _entry(fit.command_offset_nm, "N m"),
        }
        viscous = _entry(fit.viscous_nms_rad, "N m s/rad")
        return values, {"coulomb_friction": coulomb, "viscous_friction": viscous, "residual_rms": rms_nm}
    tilt = zip(("pitch", "roll"), fit.tilt_rad.value.tolist(), fit.tilt_rad.std_err.tolist(), strict=True)
    values = {
        name: _entry(UncertainValue(angle, std), "rad") for name, angle, std in tilt if np.isfinite(angle)
    }
    if not values:
        raise InputError("no joint of this arm carries weight, so the tilt of its base cannot be measured")
    gain = _entry(fit.gain, "1")
    return values, {"torque_gain": gain, "coulomb_friction": coulomb, "residual_rms": rms_nm}


def _exact(values: ArrayLike, unit: str) -> dict[str, object]:
    return _entry(UncertainValue(np.asarray(values), np.zeros(np.shape(values))), unit)


def _entry(estimate: UncertainValue[FloatArray] | UncertainValue[float], unit: str) -> dict[str, object]:
    value, std_err = (np.asarray(part).tolist() for part in (estimate.value, estimate.std_err))
    return {"value": value, "std_err": std_err, "unit": unit}


def print_usage_hint(calibration: Calibration, path: Path, options: RunOptions) -> None:
    """Print on stderr the lines to add to the robot file, and the next command.

    Args:
        calibration: the calibration.
        path: its file.
        options: options that name the robot.
    """
    stderr, robot_file = console.stderr(), options.robot_file
    file, is_shipped = robot_file.path, options.robot in shipped_robots()
    unit = getattr(calibration, "reading_unit", "N")
    if unit != "N":
        stderr.print(
            f"\nThis calibration is for readings in {unit}. A robot file cannot use it, because a robot's "
            "driver reads N."
        )
        again = f"palpate calibrate force {options.robot_words} --weights-kg 0,0.5,1,2,1,0.5,0"
        console.next_steps((again, "calibrate the sensor through the robot's driver"))
        return
    if is_shipped:
        stderr.print(
            f"\nTo use this calibration, copy the shipped arm, and write into the copy's {safe(file.name)}:"
        )
    else:
        stderr.print(f"\nTo use this calibration, write into {display_path(file)}:", soft_wrap=True)
    named = {kind: name for kind, name in robot_file.calibration.model_dump().items() if name is not None}
    folder = file.resolve().parent
    named[calibration.kind] = str(path.relative_to(folder) if path.is_relative_to(folder) else path)
    line = yaml.safe_dump(named, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10_000)
    stderr.print(f"  calibration: {safe(line.strip())}", soft_wrap=True)
    wire = " --wire" if calibration.source == "emulated" else ""
    if wire:
        stderr.print(
            "This calibration was made with emulated devices: a real arm refuses it, so use it only with "
            "--wire."
        )
    if is_shipped:
        copy = Path(f"my_{options.robot}")
        console.next_steps(
            (f"cp -r {shell_path(file.parent)} {copy}", "copy the arm's files, to change them"),
            (
                f"palpate probe --robot {copy / file.name}",
                "probe with this calibration, once the robot file names it",
            ),
        )
        return
    gentle = "" if is_simulated(robot_file) else f" {FIRST_PROBE}"
    console.next_steps(
        (
            f"palpate probe {options.robot_words}{wire}{gentle}",
            "probe with this calibration, once the robot file names it",
        )
    )
