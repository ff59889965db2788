"""Calibrations: the file, who may use it, and the one place where it corrects what devices say."""

from robot_io.calibration.applied import NO_CALIBRATIONS, Calibrations, load_calibrations, parse_calibrations
from robot_io.calibration.file import (
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
from robot_io.calibration.identity import device_identity, first_difference, urdf_sha256
from robot_io.calibration.plausible import doubtful

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
