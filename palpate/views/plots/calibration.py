"""What a calibration rests on: measurements and what is left of them once it is applied."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.arm.fit import ArmFit
from calibration.encoder.fit import EncoderFit
from calibration.force.fit import ForceFit
from palpate.views import style

MILLI = 1e3
BRANCHES = ((-1.0, "on the way down", "v"), (0.0, "at the start", "o"), (1.0, "on the way up", "^"))
MARKER = 6.0
DOT = 2.4


def force_figure(fit: ForceFit, reading_unit: str) -> Figure:
    """Characteristic of a force sensor, and the residuals of the calibrated one."""
    figure = style.new_figure(8.6, 4.0)
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1, 1.35]})
    plateaus, residual = fit.plateaus, MILLI * fit.residual_n
    scale = fit.scale.std_err / fit.scale.value
    for direction, label, marker in BRANCHES:
        rows = plateaus.direction == direction
        if rows.any():
            look = {"marker": marker, "linestyle": "", "markersize": MARKER, "color": style.MEASURED}
            left.plot(plateaus.reading[rows], plateaus.reference_n[rows], **look)
            right.plot(plateaus.reference_n[rows], residual[rows], label=label, **look)
    reading = np.linspace(plateaus.reading.min(), plateaus.reading.max(), 200)
    above = reading - fit.zero.value
    curvature = fit.curvature.value if fit.curvature else 0.0
    left.plot(reading, above * (fit.scale.value + curvature * above), color=style.MODEL, linewidth=1.0)
    left.set(xlabel=f"reading  [{reading_unit}]", ylabel="reference  [N]")
    force = np.linspace(*fit.range_n, 200)
    band = 2 * MILLI * np.hypot(fit.zero.std_err * fit.scale.value, scale * force)
    right.fill_between(force, -band, band, color=style.INK, alpha=0.07, linewidth=0)
    right.axhline(0, color=style.INK, linewidth=0.9)
    right.set(xlabel="reference  [N]", ylabel="reference − calibrated  [mN]")
    figure.legend(loc="outside lower center", ncols=3)
    remark = (
        f"residual rms {MILLI * fit.rms_n:.2g} mN, hysteresis {MILLI * fit.hysteresis_n.value:.2g} mN; "
        "the grey band is ±2 standard uncertainties of zero and scale"
    )
    style.title(figure, "Force sensor against its reference", remark)
    return figure


def encoder_figure(fit: EncoderFit) -> Figure:
    """Each touch of each stop about its mean, with the uncertainty of the zero."""
    figure = style.new_figure(6.6, 3.6)
    axes = figure.subplots()
    for joint, shown in enumerate(fit.shown_rad):
        color = style.joint_color(joint)
        place = joint + 1 + 0.12 * (np.arange(len(shown)) - 0.5 * (len(shown) - 1))
        band = 2 * MILLI * fit.std_rad[joint]
        axes.fill_between([joint + 0.6, joint + 1.4], -band, band, color=color, alpha=0.12, linewidth=0)
        axes.plot(place, MILLI * (shown - shown.mean()), "o", color=color, markersize=MARKER)
    axes.axhline(0, color=style.INK, linewidth=0.9)
    axes.set_xticks(range(1, len(fit.shown_rad) + 1), [f"joint {j + 1}" for j in range(len(fit.shown_rad))])
    axes.set(ylabel="shown − mean  [mrad]")
    remark = "each dot is one touch or pose; the bands are ±2 standard uncertainties of the zero"
    style.title(figure, "Encoders at what is known of the joints", remark)
    return figure


def arm_figure(fit: ArmFit) -> Figure:
    """Residual torque of each joint over its speed and over its position."""
    joints = fit.residual_nm.shape[1]
    figure = style.new_figure(8.6, 1.4 + 1.75 * joints)
    grid = figure.subplots(joints, 2, sharey="row", squeeze=False)
    for joint in range(joints):
        for axes, over, label in (
            (grid[joint][0], fit.velocity_rad_s[:, joint], "speed  [rad/s]"),
            (grid[joint][1], fit.position_rad[:, joint], "position  [rad]"),
        ):
            _residuals(axes, over, MILLI * fit.residual_nm[:, joint], style.joint_color(joint))
            if joint == joints - 1:
                axes.set_xlabel(label)
        grid[joint][0].set_ylabel(f"joint {joint + 1}  [mN m]")
    rms = MILLI * np.sqrt(np.nanmean(fit.residual_nm**2, axis=0))
    remark = (
        "measured − fitted torque, means of 50 samples; rms " + ", ".join(f"{x:.2g}" for x in rms) + " mN m"
    )
    style.title(figure, "What gain, offset, friction and tilt leave unexplained", remark)
    return figure


def _residuals(axes: Axes, over: np.ndarray, residual: np.ndarray, color: str) -> None:
    axes.plot(over, residual, ".", color=color, markersize=DOT, alpha=0.6, mew=0)
    axes.axhline(0, color=style.INK, linewidth=0.9)
