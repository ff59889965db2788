"""Calibration file: one YAML file for each kind, with values, uncertainties and their origin.

Everything under `values` is applied; `findings` are for people and are never applied.
"""

from collections.abc import Mapping
from typing import Annotated, Literal

import yaml
from pydantic import AwareDatetime, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import (
    FileModel,
    NotNegative,
    Number,
    YamlDocument,
    input_error,
    matching,
    problem_at,
    validate,
)

MAX_BYTES = 64 * 1024  # size of a file
MOST_JOINTS = 32
USABLE_GAINS = (0.2, 5.0)  # gains of a torque; others are rejected
_SMALLEST_SCALE, _LARGEST_SCALE = 0.5, 2.0  # scale of readings in N
_Text = Annotated[str, Field(min_length=1, max_length=200)]
_Sha256 = Annotated[str, matching(r"[0-9a-f]{64}", "64 hexadecimal digits, in lower case")]
_Unit = Annotated[
    str,
    matching(
        r"[A-Za-z%][A-Za-z0-9_/%]{0,19}", "1 to 20 letters, digits, _ / or %, starting with a letter or %"
    ),
]


def _refuse_number(value: object) -> object:
    """Reject a number, because it would be read as seconds since 1970."""
    if isinstance(value, int | float):
        raise PydanticCustomError("not_a_date", "expected a date such as 2026-11-20T08:00:00+00:00")
    return value


_Date = Annotated[AwareDatetime, BeforeValidator(_refuse_number)]


class Quantity(FileModel):
    """A value with its uncertainty."""

    value: Number  # in `unit`
    std_err: NotNegative  # standard uncertainty, in `unit`; twice as much covers about 95 %
    unit: Annotated[str, Field(max_length=40)]  # unit of `value` and `std_err`


class Quantities(FileModel):
    """A value with its uncertainty for each joint, from base to tip."""

    value: Annotated[tuple[Number, ...], Field(min_length=1, max_length=MOST_JOINTS)]  # shape (n,), in `unit`
    # Standard uncertainties, shape (n,), in `unit`.
    std_err: Annotated[tuple[NotNegative, ...], Field(min_length=1, max_length=MOST_JOINTS)]
    unit: Annotated[str, Field(max_length=40)]  # unit of all values and uncertainties

    @model_validator(mode="after")
    def _check_lengths(self) -> "Quantities":
        if len(self.value) != len(self.std_err):
            raise ValueError(
                f"has {len(self.value)} values but {len(self.std_err)} uncertainties; give one of each "
                "per joint"
            )
        return self


Findings = Annotated[dict[str, Quantity | Quantities], Field(max_length=40)]


class RawData(FileModel):
    """Data that a calibration was computed from."""

    file: _Text  # name of the session or data file, without its folder
    sha256: _Sha256  # hash of its bytes


class Calibration(FileModel):
    """Common part of every calibration."""

    palpate_calibration: Literal[1]  # version of this format
    kind: str  # one of the four kinds
    robot: _Text  # name of the robot in its robot file
    device: dict[str, object]  # driver and settings of the calibrated device, see `device_identity`
    # Devices that were read: real ones, a simulated robot's, or emulated ones behind real drivers. With None
    # (not stated) no robot may use the calibration.
    source: Literal["measured", "simulated", "emulated"] | None = None
    urdf_sha256: _Sha256 | None = None  # hash of the URDF whose masses were assumed; None if none were
    made_utc: _Date  # date of the calibration
    valid_until_utc: _Date  # date from which the calibration is rejected
    software_version: _Text  # version of palpate
    raw_data: RawData  # data that it was computed from
    # Other calibrations that were applied during the recording.
    made_with: Annotated[tuple[_Text, ...], Field(max_length=8)] = ()
    findings: Findings = Field(default_factory=dict)  # further results; not applied

    @property
    def joint_count(self) -> int | None:
        """Number of joints of the calibrated arm; None if the calibration does not depend on it."""
        return None

    def to_yaml(self) -> str:
        """Return the file's text, which `calibration_from` reads."""
        data = self.model_dump(mode="json", exclude_none=True)
        data["findings"] = data.pop("findings")  # last, after the applied values
        text: str = yaml.safe_dump(data, sort_keys=False, width=110, allow_unicode=True)
        return text

    @model_validator(mode="after")
    def _check_dates(self) -> "Calibration":
        if self.valid_until_utc <= self.made_utc:
            raise problem_at("valid_until_utc", f"must be after made_utc ({self.made_utc.isoformat()})")
        return self


def _expect_units(values: FileModel, units: Mapping[str, str]) -> None:
    for name, unit in units.items():
        quantity = getattr(values, name)
        if quantity is not None and quantity.unit != unit:
            raise problem_at(f"values.{name}.unit", f"must be '{unit}' (is {quantity.unit!r:.40})")


def _expect_range(name: str, values: tuple[float, ...], low: float, high: float) -> None:
    for joint, value in enumerate(values, 1):
        if not low <= value <= high:
            at = f" for joint {joint}" if len(values) > 1 else ""
            raise problem_at(
                f"values.{name}.value", f"must be between {low:g} and {high:g} (is {value:g}{at})"
            )


class ForceValues(FileModel):
    """force = scale (reading - zero) + curvature (reading - zero)^2, positive in compression [N]."""

    zero: Quantity
    scale: Quantity
    curvature: Quantity | None = None


class ForceCalibration(Calibration):
    """Calibration of the force sensor.

    A negative scale is rejected. For readings in N, so is a scale that is off by more than a factor of two,
    because the sensor's own setting is then wrong.
    """

    kind: Literal["force"]
    reading_unit: _Unit = "N"  # unit of the readings; a robot's driver reads N
    values: ForceValues

    @model_validator(mode="after")
    def _check_values(self) -> "ForceCalibration":
        unit = self.reading_unit
        _expect_units(self.values, {"zero": unit, "scale": f"N/{unit}", "curvature": f"N/{unit}^2"})
        if not self.values.scale.value > 0.0:
            raise problem_at(
                "values.scale.value",
                f"must be positive (is {self.values.scale.value:.3g}); reverse the sign of the sensor, "
                "for example with `reversed` in the section `force` of the robot file",
            )
        if unit == "N" and not _SMALLEST_SCALE <= self.values.scale.value <= _LARGEST_SCALE:
            raise problem_at(
                "values.scale.value",
                f"must be between {_SMALLEST_SCALE:g} and {_LARGEST_SCALE:g} (is "
                f"{self.values.scale.value:.3g}); if the true scale is outside this range, correct the "
                "driver's setting, such as capacity_n, and check the stated weights",
            )
        return self


class EncoderValues(FileModel):
    """position = reading + offset."""

    offset: Quantities


class EncoderCalibration(Calibration):
    """Calibration of the joints' zeros."""

    kind: Literal["encoder"]
    values: EncoderValues  # see `EncoderValues`

    @property
    def joint_count(self) -> int:
        return len(self.values.offset.value)

    @model_validator(mode="after")
    def _check_values(self) -> "EncoderCalibration":
        _expect_units(self.values, {"offset": "rad"})
        _expect_range("offset", self.values.offset.value, -3.1416, 3.1416)
        return self


class TorqueValues(FileModel):
    """joint torque = gain reading + offset; the command to a drive is (torque - command_offset) / gain."""

    gain: Quantities
    offset: Quantities
    command_offset: Quantities


class TorqueCalibration(Calibration):
    """Calibration of the drives' torques."""

    kind: Literal["torque"]
    urdf_sha256: _Sha256
    values: TorqueValues  # see `TorqueValues`

    @property
    def joint_count(self) -> int:
        return len(self.values.gain.value)

    @model_validator(mode="after")
    def _check_values(self) -> "TorqueCalibration":
        values = self.values
        _expect_units(values, {"gain": "1", "offset": "N m", "command_offset": "N m"})
        _expect_range("gain", values.gain.value, *USABLE_GAINS)
        if not len(values.gain.value) == len(values.offset.value) == len(values.command_offset.value):
            raise problem_at("values", "gain, offset and command_offset must each have one value per joint")
        return self


class GravityValues(FileModel):
    """Tilt of the base: roll about its x axis, then pitch about its y axis, positive with x downwards."""

    pitch: Quantity | None = None
    roll: Quantity | None = None


class GravityCalibration(Calibration):
    """Calibration of the base's tilt."""

    kind: Literal["gravity"]
    urdf_sha256: _Sha256
    values: GravityValues  # see `GravityValues`; an angle without effect on the torques is absent (0)

    @model_validator(mode="after")
    def _check_values(self) -> "GravityCalibration":
        if self.values.pitch is None and self.values.roll is None:
            raise problem_at("values", "pitch or roll is required")
        _expect_units(self.values, {"pitch": "rad", "roll": "rad"})
        for name in ("pitch", "roll"):
            angle = getattr(self.values, name)
            _expect_range(name, (angle.value,) if angle else (), -1.6, 1.6)
        return self


CALIBRATIONS: Mapping[str, type[Calibration]] = {
    "force": ForceCalibration,
    "encoder": EncoderCalibration,
    "torque": TorqueCalibration,
    "gravity": GravityCalibration,
}
CALIBRATION_KINDS = tuple(CALIBRATIONS)


def calibration_from(document: YamlDocument, kind: str | None = None) -> Calibration:
    """Read the calibration in a document or under one of its keys; raise `InputError` if it is invalid.

    Args:
        document: YAML.
        kind: key of the calibration; None for the whole document.
    """
    at = () if kind is None else (kind,)
    data = document.data if kind is None else document.data.get(kind)
    stated = data.get("kind") if isinstance(data, Mapping) else None
    if stated is None and isinstance(data, Mapping):
        raise InputError(f"{document.origin}: its 'kind' is missing. Valid: {', '.join(CALIBRATIONS)}")
    model = CALIBRATIONS.get(stated) if isinstance(stated, str) else None
    if model is None:
        raise input_error(document, (*at, "kind"), f"Valid: {', '.join(CALIBRATIONS)}", stated)
    return validate(model, data, document, at)
