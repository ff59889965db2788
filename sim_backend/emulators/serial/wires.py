"""Emulated force sensors for a `serial_line`."""

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

_NEWTONS = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}


class _Line(FileModel, extra="ignore"):
    baud_rate: int | None = None


class _Loadstar(FileModel, extra="ignore"):
    capacity_n: Positive
    reversed: bool = False


class _Gauge(_Loadstar, extra="ignore"):
    pass


class _Bota(_Loadstar, extra="ignore"):
    axis: Annotated[str, Field(pattern="^[xyz]$")]


class _Cell(FileModel, extra="ignore"):
    newtons_per_count: Positive
    zero_counts: Number = 0.0
    rate_hz: Annotated[int, Field(ge=1)]
    reversed: bool = False


class _Lorenz(FileModel, extra="ignore"):
    nominal_load: Positive
    unit: str
    counts_at_nominal: Positive
    dimension_code: int
    load_code: int
    reversed: bool = False


class SerialWires(WireMaker):
    """The force sensor that the robot file names, on a pseudo terminal."""

    name = "serial_line"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Line, request.section.settings)
        line = PtyLine(
            self._sensor(request),
            request.plant,
            request.faults,
            in_lock_step=request.in_lock_step,
            baud_rate=own.baud_rate,
        )
        return line, {"port": line.path}

    def _sensor(self, request: WireRequest) -> SerialSensor:
        if request.force is None:
            raise InputError("a serial_line without a force sensor cannot be emulated")
        settings = request.force.settings
        match request.force.driver:
            case "loadstar":
                loadstar = validate(_Loadstar, settings)
                return EmulatedLoadstar(loadstar.capacity_n, sign=-1.0 if loadstar.reversed else 1.0)
            case "lorenz":
                own = validate(_Lorenz, settings)
                if own.unit not in _NEWTONS:
                    raise InputError(
                        f"no emulated sensor counts in '{own.unit}'. Valid: {', '.join(_NEWTONS)}"
                    )
                return EmulatedLorenz(
                    own.nominal_load * _NEWTONS[own.unit],
                    own.counts_at_nominal,
                    own.dimension_code,
                    own.load_code,
                    sign=-1.0 if own.reversed else 1.0,
                )
            case "microcontroller_cell":
                cell = validate(_Cell, settings)
                sign = -1.0 if cell.reversed else 1.0
                return EmulatedCell(cell.newtons_per_count, cell.zero_counts, cell.rate_hz, sign)
            case "mark10":
                mark10 = validate(_Loadstar, settings)
                return EmulatedMark10(mark10.capacity_n, sign=-1.0 if mark10.reversed else 1.0)
            case "bota":
                bota = validate(_Bota, settings)
                return EmulatedBota(
                    "xyz".index(bota.axis), bota.capacity_n, sign=-1.0 if bota.reversed else 1.0
                )
            case "force_lines":
                gauge = validate(_Gauge, settings)
                return EmulatedGauge(gauge.capacity_n, sign=-1.0 if gauge.reversed else 1.0)
        raise InputError(
            f"no sensor is emulated for the driver '{request.force.driver}'. Emulated: bota, force_lines, "
            "loadstar, lorenz, mark10, microcontroller_cell; name one of them to try the rest of the arm, "
            "or do without --wire"
        )
