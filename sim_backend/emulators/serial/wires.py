"""Emulated force sensors for a `serial_line`."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from robot_io.errors import InputError
from robot_io.files.file_model import FileModel, Number, Positive, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.serial.bota import EmulatedBota
from sim_backend.emulators.serial.cell import EmulatedCell
from sim_backend.emulators.serial.mark10 import EmulatedMark10
from sim_backend.emulators.serial.pty_line import PtyLine, SerialSensor
from sim_backend.emulators.serial.sensors import EmulatedGauge, EmulatedLoadstar, EmulatedLorenz
from sim_backend.emulators.wiring import WireMaker, WireRequest

_NEWTONS = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665}


def newtons_per(unit: str) -> float:
    """Newtons in one `unit`. InputError: no emulated sensor counts in it."""
    if unit not in _NEWTONS:
        raise InputError(f"no emulated sensor counts in '{unit}'. Valid: {', '.join(_NEWTONS)}")
    return _NEWTONS[unit]


class SensorSettings(FileModel, extra="ignore"):
    """What a robot file says of any force sensor."""

    reversed: bool = False

    def signed(self, sensor: SerialSensor) -> SerialSensor:
        """The sensor as it is mounted."""
        sensor.sign = -1.0 if self.reversed else 1.0
        return sensor


class _Ranged(SensorSettings):
    capacity_n: Positive


class AxisSettings(_Ranged):
    """The same of one axis of several."""

    axis: Annotated[str, Field(pattern="^[xyz]$")]

    @property
    def axis_index(self) -> int:
        """From 0."""
        return "xyz".index(self.axis)


class _Cell(SensorSettings):
    newtons_per_count: Positive
    zero_counts: Number = 0.0
    rate_hz: Annotated[int, Field(ge=1)]


class _Lorenz(SensorSettings):
    nominal_load: Positive
    unit: str
    counts_at_nominal: Positive
    dimension_code: int
    load_code: int


def _lorenz(own: _Lorenz) -> EmulatedLorenz:
    nominal_n = own.nominal_load * newtons_per(own.unit)
    return EmulatedLorenz(nominal_n, own.counts_at_nominal, own.dimension_code, own.load_code)


# By driver: what a robot file says, and the sensor that stands for it.
_SENSORS: dict[str, tuple[type[SensorSettings], Callable[[Any], SerialSensor]]] = {
    "bota": (AxisSettings, lambda own: EmulatedBota(own.axis_index, own.capacity_n)),
    "force_lines": (_Ranged, lambda own: EmulatedGauge(own.capacity_n)),
    "loadstar": (_Ranged, lambda own: EmulatedLoadstar(own.capacity_n)),
    "lorenz": (_Lorenz, _lorenz),
    "mark10": (_Ranged, lambda own: EmulatedMark10(own.capacity_n)),
    "microcontroller_cell": (
        _Cell,
        lambda own: EmulatedCell(own.newtons_per_count, own.zero_counts, own.rate_hz),
    ),
}


class _Line(FileModel, extra="ignore"):
    baud_rate: int | None = None


class SerialWires(WireMaker):
    """The force sensor that the robot file names, on a pseudo terminal."""

    name = "serial_line"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        line = PtyLine(
            _sensor(request),
            request.plant,
            request.faults,
            in_lock_step=request.in_lock_step,
            baud_rate=validate(_Line, request.section.settings).baud_rate,
        )
        return line, {"port": line.path}


def _sensor(request: WireRequest) -> SerialSensor:
    if request.force is None:
        raise InputError("a serial_line without a force sensor cannot be emulated")
    if request.force.driver not in _SENSORS:
        raise InputError(
            f"no sensor is emulated for the driver '{request.force.driver}'. Emulated: "
            f"{', '.join(_SENSORS)}; name one of them to try the rest of the arm, or do without --wire"
        )
    model, make = _SENSORS[request.force.driver]
    own = validate(model, request.force.settings)
    return own.signed(make(own))
