"""Calibrations: the file, its checks, and the devices that it corrects."""

from palpate.robot_io.calibration.applied import (
    NO_CALIBRATIONS,
    Calibrations,
    device_identity,
    doubtful,
    first_difference,
    load_calibrations,
    parse_calibrations,
    urdf_sha256,
)
from palpate.robot_io.calibration.file import (
    Calibration,
    EncoderCalibration,
    ForceCalibration,
    GravityCalibration,
    Quantities,
    Quantity,
    RawData,
    TorqueCalibration,
    load_calibration,
    parse_calibration,
)

__all__ = [
    "NO_CALIBRATIONS",
    "Calibration",
    "Calibrations",
    "EncoderCalibration",
    "ForceCalibration",
    "GravityCalibration",
    "Quantities",
    "Quantity",
    "RawData",
    "TorqueCalibration",
    "device_identity",
    "doubtful",
    "first_difference",
    "load_calibration",
    "load_calibrations",
    "parse_calibration",
    "parse_calibrations",
    "urdf_sha256",
]
