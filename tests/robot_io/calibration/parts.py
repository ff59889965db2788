"""Calibrations of the mock robot, and robot files that name them."""

from datetime import UTC, datetime
from pathlib import Path

from palpate.robot_io.calibration.applied import device_identity, urdf_sha256
from palpate.robot_io.calibration.file import (
    MAX_BYTES,
    Calibration,
    EncoderCalibration,
    ForceCalibration,
    GravityCalibration,
    TorqueCalibration,
    calibration_from,
)
from palpate.robot_io.files.file_model import load_yaml, parse_yaml
from palpate.robot_io.robot_file import RobotFile, load_robot_file
from tests.mock_robot import write_mock_files

MADE = datetime(2026, 11, 20, 8, tzinfo=UTC)
NOW = datetime(2027, 3, 1, tzinfo=UTC)
END = datetime(2027, 11, 20, 8, tzinfo=UTC)
KINDS = ("force", "encoder", "torque", "gravity")


def quantity(value: float, unit: str) -> dict:
    return {"value": value, "std_err": 0.001, "unit": unit}


def quantities(values: list[float], unit: str) -> dict:
    return {"value": values, "std_err": [0.001] * len(values), "unit": unit}


VALUES = {
    "force": {
        "zero": quantity(0.5, "N"),
        "scale": quantity(0.8, "N/N"),
        "curvature": quantity(0.002, "N/N^2"),
    },
    "encoder": {"offset": quantities([0.1, -0.2, 0.3], "rad")},
    "torque": {
        "gain": quantities([0.5, 1.0, 2.0], "1"),
        "offset": quantities([0.1, 0.2, 0.3], "N m"),
        "command_offset": quantities([0.0, 0.1, -0.2], "N m"),
    },
    "gravity": {"pitch": quantity(0.05, "rad")},
}
MODELS = {
    "force": ForceCalibration,
    "encoder": EncoderCalibration,
    "torque": TorqueCalibration,
    "gravity": GravityCalibration,
}


def calibration_of(kind: str, robot_file: RobotFile, **changes):
    """A calibration of this robot that is valid at `NOW`."""
    content = {
        "palpate_calibration": 1,
        "kind": kind,
        "robot": robot_file.name,
        "device": device_identity(robot_file, kind),
        "source": "measured",
        "made_utc": MADE.isoformat(),
        "valid_until_utc": END.isoformat(),
        "software_version": "0.1.0",
        "raw_data": {"file": "a.mcap", "sha256": "0" * 64},
        "values": VALUES[kind],
    }
    if kind in ("torque", "gravity"):
        content["urdf_sha256"] = urdf_sha256(robot_file)
    return MODELS[kind].model_validate(content | changes)


def robot_with(folder: Path, *kinds: str, **changes) -> RobotFile:
    """The mock robot's file in `folder`, naming a calibration of each kind that lies beside it."""
    path = write_mock_files(folder)
    plain = load_robot_file(path)
    for kind in kinds:
        (folder / f"{kind}.yaml").write_text(calibration_of(kind, plain, **changes).to_yaml())
    if kinds:
        lines = "".join(f"  {kind}: {kind}.yaml\n" for kind in kinds)
        path.write_text(path.read_text() + "\ncalibration:\n" + lines)
    return load_robot_file(path)


def load_calibration(path: Path) -> Calibration:
    return calibration_from(load_yaml(path, MAX_BYTES))


def parse_calibration(text: str, origin: str) -> Calibration:
    return calibration_from(parse_yaml(text, origin, MAX_BYTES))
