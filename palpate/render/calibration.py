"""A calibration's values as a table, and figures of the data behind them."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots
from rich.console import Console

from palpate.calibration.arm_fit import ArmFit
from palpate.calibration.encoder import EncoderFit
from palpate.calibration.force import ForceFit
from palpate.common.console import safe, significant, table
from palpate.render import palette
from palpate.render.report import styled, title_axes
from palpate.robot_io.calibration.applied import find_large_zero_shift
from palpate.robot_io.calibration.file import Calibration, Quantities, Quantity

_TO_MILLI = 1e3
_BRANCHES = (
    (-1.0, "on the way down", "triangle-down"),
    (0.0, "at the start", "circle"),
    (1.0, "on the way up", "triangle-up"),
)


def print_calibration(console: Console, calibration: Calibration, remarks: Sequence[str]) -> None:
    """Print the applied values and further findings.

    Args:
        console: console to print to.
        calibration: values and findings.
        remarks: further sentences.
    """
    title = f"Calibration of {calibration.kind}, robot {safe(calibration.robot)}"
    made = table(title, "what", "value", "± (1 std)", "unit", "", right=("value", "± (1 std)"))
    values = getattr(calibration, "values")  # noqa: B009, each kind has its own
    for name in type(values).model_fields:
        if (quantity := getattr(values, name)) is not None:
            for row in _rows(name, quantity):
                made.add_row(*row, "applied")
    for name, quantity in calibration.findings.items():
        for row in _rows(name, quantity):
            made.add_row(*(f"[dim]{cell}[/dim]" for cell in row), "[dim]found, not applied[/dim]")
    console.print(made)
    if shift_warning := find_large_zero_shift(calibration):
        console.print(f"[bold red]check again:[/bold red] {safe(shift_warning)}", soft_wrap=True)
    for remark in remarks:
        console.print(f"[yellow]{safe(remark)}[/yellow]")


def _rows(name: str, quantity: Quantity | Quantities) -> Iterator[tuple[str, str, str, str]]:
    what, unit = name.replace("_", " "), "" if quantity.unit == "1" else quantity.unit
    if isinstance(quantity, Quantity):
        parts = [(what, quantity.value, quantity.std_err)]
    else:
        several = range(1, len(quantity.value) + 1)
        labels = ("from", "to") if name == "range" else [f"joint {joint}" for joint in several]
        every = zip(labels, quantity.value, quantity.std_err, strict=True)
        parts = [(f"{what}, {part}", value, error) for part, value, error in every]
    for label, value, error in parts:
        yield label, significant(value, error or None), f"{error:.2g}" if error else "", unit


def force_figure(fit: ForceFit, reading_unit: str) -> go.Figure:
    """Draw a force sensor's characteristic, and its residuals after calibration.

    Args:
        fit: fit of the force sensor.
        reading_unit: unit of the raw reading.
    """
    made = make_subplots(1, 2, column_widths=[0.43, 0.57])
    plateaus = fit.plateaus
    for direction, label, symbol in _BRANCHES:
        rows = plateaus.direction == direction
        if rows.any():
            marker = {"symbol": symbol, "size": 9, "color": palette.MEASURED}
            look = {"name": label, "legendgroup": label, "marker": marker}
            reference = plateaus.reference_n[rows]
            _dots(made, plateaus.reading[rows], reference, (1, 1), showlegend=False, **look)
            _dots(made, reference, _TO_MILLI * fit.residual_n[rows], (1, 2), **look)
    reading = np.linspace(plateaus.reading.min(), plateaus.reading.max(), 200)
    above, curvature = reading - fit.zero.value, fit.curvature.value if fit.curvature else 0.0
    force = above * (fit.scale.value + curvature * above)
    line = {"color": palette.MODEL, "width": 1.4}
    made.add_trace(go.Scatter(x=reading, y=force, mode="lines", line=line, showlegend=False), 1, 1)
    range_n = np.linspace(*fit.range_n, 200)
    scale = fit.scale.std_err / fit.scale.value
    band = 2 * _TO_MILLI * np.hypot(fit.zero.std_err * fit.scale.value, scale * range_n)
    around = {"x": np.concatenate([range_n, range_n[::-1]]), "y": np.concatenate([band, -band[::-1]])}
    made.add_trace(
        go.Scatter(**around, fill="toself", fillcolor=palette.SHADE, line_width=0, showlegend=False), 1, 2
    )
    title_axes(made, (1, 1), f"reading [{reading_unit}]", "reference [N]")
    title_axes(made, (1, 2), "reference [N]", "reference − calibrated [mN]")
    remark = (
        f"residual rms {_TO_MILLI * fit.rms_n:.2g} mN, "
        f"hysteresis {_TO_MILLI * fit.hysteresis_n.value:.2g} mN; "
        "the gray band is ±2 standard uncertainties of zero and scale"
    )
    return _titled(made, 460, "Force sensor against its reference", remark)


def encoder_figure(fit: EncoderFit) -> go.Figure:
    """Draw each touch of each stop about its mean, with the uncertainty of the zero."""
    made = make_subplots(1, 1)
    for joint, (shown, std_rad) in enumerate(zip(fit.shown_rad, fit.std_rad, strict=True)):
        place = joint + 1 + 0.12 * (np.arange(len(shown)) - 0.5 * (len(shown) - 1))
        band, color = 2 * _TO_MILLI * float(std_rad), palette.JOINTS[joint % len(palette.JOINTS)]
        look = {"fillcolor": color, "opacity": 0.15, "line_width": 0}
        made.add_shape(type="rect", x0=joint + 0.6, x1=joint + 1.4, y0=-band, y1=band, **look)
        dots = {"marker": {"size": 9, "color": color}, "showlegend": False}
        _dots(made, place, _TO_MILLI * (shown - shown.mean()), (1, 1), **dots)
    numbers = list(range(1, len(fit.shown_rad) + 1))
    made.update_xaxes(tickvals=numbers, ticktext=[f"joint {number}" for number in numbers])
    made.update_yaxes(title_text="shown − mean [mrad]")
    remark = "each dot is one touch or pose; the bands are ±2 standard uncertainties of the zero"
    return _titled(made, 420, "Encoders at known joint positions", remark)


def arm_figure(fit: ArmFit) -> go.Figure:
    """Draw each joint's residual torque over speed and over position.

    Args:
        fit: fit of the drives and the base.
    """
    joints = fit.residual_nm.shape[1]
    made = make_subplots(joints, 2, shared_yaxes=True, vertical_spacing=0.07, horizontal_spacing=0.03)
    for joint in range(joints):
        residual, color = _TO_MILLI * fit.residual_nm[:, joint], palette.JOINTS[joint % len(palette.JOINTS)]
        look = {"marker": {"size": 3, "opacity": 0.6, "color": color}, "showlegend": False}
        _dots(made, fit.velocity_rad_s[:, joint], residual, (joint + 1, 1), **look)
        _dots(made, fit.position_rad[:, joint], residual, (joint + 1, 2), **look)
        made.update_yaxes(title_text=f"joint {joint + 1} [mN m]", row=joint + 1, col=1)
    made.update_xaxes(title_text="speed [rad/s]", row=joints, col=1)
    made.update_xaxes(title_text="position [rad]", row=joints, col=2)
    rms = ", ".join(f"{x:.2g}" for x in _TO_MILLI * np.sqrt(np.nanmean(fit.residual_nm**2, axis=0)))
    remark = f"measured − fitted torque, means of 50 samples; rms {rms} mN m"
    title = "Residual after gain, offset, friction and tilt"
    return _titled(made, 140 + 190 * joints, title, remark)


def _dots(made: go.Figure, x: NDArray[Any], y: NDArray[Any], place: tuple[int, int], **look: object) -> None:
    made.add_trace(go.Scatter(x=np.asarray(x), y=np.asarray(y), mode="markers", **look), *place)


def _titled(made: go.Figure, height: int, title: str, remark: str) -> go.Figure:
    styled(made, height)
    text = f"<b>{title}</b><br><span style='font-size:12px'>{remark}</span>"
    return made.update_layout(title={"text": text, "x": 0.01, "font_size": 15}, margin_t=110)
