"""Figures of a sweep for print, one or two columns wide."""

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from palpate.control.loop.task import IN_CONTACT, Phase
from palpate.render.palette import BASE, JOINTS, MEASURED, MODEL, NOISE, TRUTH
from palpate.sweep.case import Row
from palpate.sweep.rows import BOUND, column, errors_of, estimated, grouped, parameters_of

ONE_COLUMN_IN, TWO_COLUMNS_IN = 3.5, 7.16
SPEEDS = ("#b23a5c", "#de7a26", "#2b7a92")  # from fast to slow
_STIFFNESSES = ("#4a6fb5", "#2b9a92", "#e2a13c", "#b23a5c")  # from soft to stiff
K, C = "stiffness.k", "damping.c"
PAPER = "#5f6b78"
_INWARDS = (Phase.APPROACH, Phase.LOADING, Phase.HOLD)
_STYLE: Any = {
    **mpl.rcParamsDefault,  # ignores a matplotlibrc in the current folder
    "font.family": "sans-serif",
    "font.sans-serif": ["Liberation Sans", "Arial", "DejaVu Sans"],
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "svg.fonttype": "none",
    "svg.hashsalt": "palpate",
    "savefig.dpi": 220,
    "figure.constrained_layout.use": True,
}
_KNOWN = {
    "lsq": MEASURED,
    "ransac": MODEL,
    "robust": NOISE,
    "weighted": "#9a6fc4",
    "rls": "#5aa7b5",
    "ewrls": "#a08a2e",
}


def save(figure: Figure, path: str) -> None:
    """Write a figure, as PNG or SVG by the path's extension; raise `OSError` if it cannot be written.

    Args:
        figure: figure to write.
        path: ends in .png or .svg.
    """
    with mpl.rc_context(_STYLE):
        figure.savefig(path, metadata={"Date": None} if path.endswith("svg") else None)


@mpl.rc_context(_STYLE)
def torques(ticks: Sequence[Row]) -> Figure:
    """Draw figure 3a: commanded and measured torque of each joint over the first run.

    Args:
        ticks: rows of one probing.
    """
    own = [row for row in ticks if row["run"] == 0]
    time_s = column(own, "time_s")
    time_s -= time_s[0]
    touching = np.isin([row["phase"] for row in own], IN_CONTACT)
    figure, all_axes = _panels("fig3a_torque", 3, 1, TWO_COLUMNS_IN, 3.6, sharex=True)
    for joint, axes in enumerate(all_axes, 1):
        axes.axvspan(time_s[touching][0], time_s[touching][-1], color="#f0e4d4", lw=0)
        for what, style in (("measured", {"color": JOINTS[joint - 1], "lw": 2.4, "alpha": 0.55}),
                            ("commanded", {"color": "#1d2733", "lw": 0.7})):  # fmt: skip
            axes.plot(time_s, column(own, f"torque_{what}_{joint}_nm"), label=what, **style)
        axes.set_ylabel(f"joint {joint} [N m]")
        # A margin above and below, and a minimum span, so that noise does not fill a panel.
        low, high = axes.get_ylim()
        more = max(0.0, 0.5 - (high - low)) / 2 + 0.1 * (high - low)
        axes.set_ylim(low - more, high + more)
    all_axes[0].legend(loc="upper right", ncols=2)
    all_axes[-1].set_xlabel("time [s]; shaded: in contact")
    return figure


@mpl.rc_context(_STYLE)
def transition(ticks: Sequence[Row]) -> Figure:
    """Draw figure 3b: torques around the first contact, at the middle speed.

    Args:
        ticks: rows of one probing.
    """
    own = [row for row in ticks if row["run"] == 1]
    touch = next(i for i, row in enumerate(own) if row["phase"] == Phase.LOADING)
    own = own[touch - 60 : touch + 200]
    time_ms = 1e3 * (column(own, "time_s") - own[60]["time_s"])
    figure, (above, below) = _panels("fig3b_transition", 2, 1, ONE_COLUMN_IN, 3.4, sharex=True)
    for joint in (1, 2, 3):
        torque = column(own, f"torque_commanded_{joint}_nm")
        above.plot(time_ms, torque - torque[:40].mean(), color=JOINTS[joint - 1], label=f"joint {joint}")
    above.set_ylabel("change of torque [N m]")
    above.legend(loc="center right", bbox_to_anchor=(1.0, 0.38))
    below.plot(time_ms, column(own, "force_n"), color=MEASURED)
    below.axhline(10.0, color=TRUTH, lw=0.8, ls="--")
    below.text(time_ms[0], 9.8, "limit", color=TRUTH, va="top", fontsize=7)
    below.set(xlabel="time since the touch was detected [ms]", ylabel="contact force [N]")
    for axes in (above, below):
        axes.axvline(0.0, color=BASE, lw=0.8)
    return figure


@mpl.rc_context(_STYLE)
def force_displacement(ticks: Sequence[Row], grid: Sequence[Row]) -> Figure:
    """Draw figure 4a: force over displacement at three speeds, and peak forces over c v.

    Args:
        ticks: rows of one probing.
        grid: rows of the grid, one for each probing.
    """
    figure, (left, right) = _panels("fig4a_force_displacement", 1, 2, TWO_COLUMNS_IN, 2.7)
    for run, (speed_mm_s, color) in enumerate(zip((150, 90, 60), SPEEDS, strict=True)):
        own = [row for row in ticks if row["run"] == run and row["phase"] in _INWARDS]
        own = [row for row in own if row["depth_m"] is not None and row["depth_m"] > -5e-4]
        depth = 1e3 * column(own, "depth_m")
        left.plot(depth, column(own, "force_n"), color=color, lw=1.0, label=f"{speed_mm_s} mm/s")
        ends = np.array([0.0, depth.max()])
        left.plot(ends, 0.5 * ends + 0.1 * speed_mm_s, color=color, lw=0.7, ls=":")
    left.axhline(10.0, color=TRUTH, lw=0.8, ls="--")
    left.text(left.get_xlim()[1], 10.15, "limit", color=TRUTH, ha="right", va="bottom", fontsize=7)
    left.set(xlabel="displacement [mm]", ylabel="force [N]", ylim=(-0.5, 17))
    left.set_title("force; dotted: k·x + c·v at the set speed")
    left.legend()
    # peak force over the dashpot's force at the touch
    for number, color in enumerate(SPEEDS):
        speeds_mm_s = [float(row["speeds_mm_s"].split(", ")[number]) for row in grid]
        jump = 1e-3 * column(grid, "law damping_n_s_m") * speeds_mm_s
        right.plot(jump, [row["peak_n"][number] for row in grid], "o", ms=2.2, color=color, alpha=0.6, mew=0)
    ends = np.array([0.0, 15.5])
    right.plot(ends, ends, color=BASE, lw=0.8, ls=":")
    right.axhline(10.0, color=TRUTH, lw=0.8, ls="--")
    right.set(xlabel="c·v at the set speed [N]", ylabel="highest measured force [N]", ylim=(0, 17))
    right.set_title("all objects of the grid")
    return figure


@mpl.rc_context(_STYLE)
def grid_estimates(rows: Sequence[Row]) -> Figure:
    """Draw figures 4b and 4c: estimates over the grid, and their errors with the paper's worst errors."""
    figure, all_axes = _panels("fig4bc_estimates", 2, 2, TWO_COLUMNS_IN, 5.0)
    good = estimated(rows)
    k_axis, c_axis = ("law stiffness_n_m", "k [N/m]"), ("law damping_n_s_m", "c [N s/m]")
    sides = ((K, k_axis, c_axis, (6.5, 20.6)), (C, c_axis, k_axis, (18.4, 29.5)))
    for (name, own_axis, other_axis, papers), (above, below) in zip(sides, all_axes.T, strict=True):
        for true, own in grouped(good, itemgetter(own_axis[0])).items():
            x = column(own, other_axis[0])
            above.plot([x.min(), x.max()], [true, true], color=BASE, lw=0.7)
        marks: Any = {"lsq": {"ms": 4.5, "mfc": "none", "mew": 0.6}, "ransac": {"ms": 2.0, "mew": 0}}
        for method, style in marks.items():
            own = [row for row in good if row["estimator"] == method]
            above.plot(column(own, other_axis[0]), column(own, name), "o", color=_KNOWN[method], **style)
        figure_name = "4b" if name == K else "4c"
        above.set(xlabel=f"true {other_axis[1]}", ylabel=f"estimate of {own_axis[1]}")
        above.set_title(f"{figure_name}: dots RANSAC, rings LSQ, lines the truth")
        for number, (estimator, own) in enumerate(grouped(good, lambda row: row["estimator"]).items()):
            points = []
            for value, some in grouped(own, itemgetter(other_axis[0])).items():
                relative = errors_of(some, name).relative
                if len(relative):
                    points.append((value, 100 * np.abs(relative).max()))
            at, worst = zip(*sorted(points), strict=True)
            look: dict[str, Any] = {"color": _color(estimator, number), "marker": "o", "ms": 2.2, "lw": 1.0}
            below.plot(at, worst, label=estimator, **look)
        for value, method, place in zip(papers, ("RANSAC", "LSQ"), ("top", "bottom"), strict=True):
            below.axhline(value, color=PAPER, lw=0.9, ls="--")
            text = f"paper, {method}, worst"
            below.text(below.get_xlim()[1], value, text, color=PAPER, ha="right", va=place, fontsize=6.5)
        below.set(xlabel=f"true {other_axis[1]}", ylabel=f"worst error of {name[-1]} [%]")
        below.set(yscale="log", ylim=(0.003, 120))
        _percent_ticks(below)
    all_axes[1][0].legend(loc="lower left", ncols=3, fontsize=6.5)
    return figure


@mpl.rc_context(_STYLE)
def noise(lines: Sequence[Sequence[Any]]) -> Figure:
    """Draw figure 4d: mean error over the noise.

    Args:
        lines: rows of the table in `palpate.sweep.paper`, by estimator and noise.
    """
    figure, all_axes = _panels("fig4d_noise", 1, 2, TWO_COLUMNS_IN, 2.8)
    for index, (axes, what) in enumerate(zip(all_axes, ("k", "c"), strict=True)):
        for number, (name, own) in enumerate(grouped(lines, lambda line: line[0]).items()):
            dashes, color = "-" if number < 4 else "--" if "1" in name else ":", _color(name, number)
            x, error = zip(*((line[1], line[2 + index]) for line in own), strict=True)
            axes.plot(x, error, dashes, color=color, marker="o", ms=2.5, label=name)
        reference = [line for line in lines if line[0] == lines[0][0]]
        noise_percent, least = zip(*((line[1], line[6 + index]) for line in reference), strict=True)
        axes.plot(noise_percent, least, color="#1d2733", lw=0.9, ls=(0, (1, 1)), label="bound")
        axes.set(yscale="log", xlabel="noise [% of the force]", ylabel=f"mean error of {what} [%]")
        _percent_ticks(axes, (1, 2, 5))
    all_axes[0].legend(fontsize=6.5, loc="lower right")
    return figure


@mpl.rc_context(_STYLE)
def ransac_map(by_noise: Mapping[str, Sequence[Row]]) -> Figure:
    """Draw the ratio of k's error to its bound over RANSAC's threshold and subset, and threshold and trials.

    Args:
        by_noise: rows of all settings, by the name of the noise.
    """
    figure, all_axes = _panels("ransac_map", 2, 3, TWO_COLUMNS_IN, 4.4)
    norm = LogNorm(1, 100)
    image: Any = None
    for (above, below), (name, own) in zip(all_axes.T, by_noise.items(), strict=True):
        for axes, along, fixed, value in ((above, "subset", "trials", 1000), (below, "trials", "subset", 5)):
            shown = [row for row in own if row[fixed] == value]
            x, y = (sorted({row[key] for row in shown}) for key in ("threshold", along))
            errors = np.full((len(y), len(x)), np.nan)
            for row in shown:
                errors[y.index(row[along]), x.index(row["threshold"])] = row["k_over_bound"]
            image = axes.imshow(errors, origin="lower", aspect="auto", cmap="viridis_r", norm=norm)
            for (i, j), error in np.ndenumerate(errors):
                text = f"{error:.1f}" if error < 10 else f"{error:.0f}" if error < 1000 else ">999"
                color = "white" if error > 8 else "#1d2733"
                axes.text(j, i, text, ha="center", va="center", fontsize=5.5, color=color)
            axes.set_xticks(range(len(x)), [f"{value:g}" for value in x], fontsize=6.5, rotation=45)
            axes.set_yticks(range(len(y)), [f"{value:g}" for value in y], fontsize=6.5)
            axes.grid(visible=False)
        above.set_title(name)
        above.set_ylabel("samples in a subset\n(1000 trials)")
        below.set(xlabel="threshold [N]", ylabel="trials\n(subsets of 5)")
    figure.colorbar(
        image, ax=all_axes, label="error in k divided by the bound", extend="max", shrink=0.8, format="%g"
    )
    return figure


@mpl.rc_context(_STYLE)
def hunt_crossley(rows: Sequence[Row], best: str) -> Figure:
    """Draw the best estimator's errors of k, b and n by object, with plus and minus one bound.

    Args:
        rows: rows of all objects.
        best: name of the estimator.
    """
    figure, all_axes = _panels("hunt_crossley", 1, 3, TWO_COLUMNS_IN, 2.7)
    own = [row for row in estimated(rows) if row["estimator"] == best]
    by_stiffness = sorted(grouped(own, itemgetter("law stiffness")).items())
    for axes, parameter in zip(all_axes, parameters_of(own), strict=True):
        for (stiffness, group), color in zip(by_stiffness, _STIFFNESSES, strict=False):
            true = column(group, f"true {parameter}")
            beside = 0.02 * (np.log10(column(group, "law damping") / stiffness) + 0.5)
            x = column(group, "law exponent") + beside
            error = 100 * (column(group, parameter) / true - 1)
            bound = 100 * column(group, BOUND + parameter) / true
            axes.errorbar(x, error, bound, fmt="o", ms=3, lw=0.9, color=color, label=f"k = {stiffness:g}")
        axes.axhline(0.0, color="#1d2733", lw=0.7)
        axes.set(xlabel="exponent n", ylabel=f"error of {parameter.split('.')[-1]} [%]")
    handles, labels = all_axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, title=f"{best}; bars: the bound")
    return figure


@mpl.rc_context(_STYLE)
def error_spread(rows: Sequence[Row]) -> Figure:
    """Draw the distribution of relative errors by estimator, one panel per parameter, for any sweep.

    Args:
        rows: rows of any cases.
    """
    good = estimated(rows)
    parameters = parameters_of(good)
    groups = grouped(good, lambda row: row["estimator"])
    height_in = 0.9 + 0.26 * len(groups)
    figure, all_axes = _panels("errors", 1, max(len(parameters), 1), TWO_COLUMNS_IN, height_in, sharey=True)
    for axes, parameter in zip(all_axes, parameters, strict=False):
        for y, own in enumerate(groups.values()):
            values = np.maximum(100 * np.abs(errors_of(own, parameter).relative), 1e-4)
            axes.plot(values, np.full(len(values), y), "|", color=MEASURED, ms=7, alpha=0.5)
            if len(values):
                axes.plot(np.median(values), y, "o", color=MODEL, ms=4)
        axes.set(xscale="log", xlabel=f"error of {parameter} [%]")
        axes.set_yticks(range(len(groups)), list(groups))
        axes.set_ylim(len(groups) - 0.5, -0.5)  # complete rows, in the order of the table
    return figure


def _panels(
    name: str, rows: int, columns: int, width_in: float, height_in: float, **shared: bool
) -> tuple[Figure, Any]:
    """Make a figure of panels; its label is the name of its files."""
    figure = Figure(figsize=(width_in, height_in))
    figure.set_label(name)
    axes = figure.subplots(rows, columns, squeeze=False, **shared)  # type: ignore[call-overload]
    return figure, axes if rows > 1 and columns > 1 else axes.ravel()


def _percent_ticks(axes: Axes, digits: Sequence[int] = (1,)) -> None:
    ticks = [float(f"{digit}e{power}") for power in range(-3, 3) for digit in digits]
    axes.yaxis.set_major_locator(FixedLocator(ticks))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _color(estimator: str, number: int) -> str:
    return _KNOWN.get(estimator, _SPARE[number % len(_SPARE)])


_SPARE = ("#d1495b", "#7f8c2d", "#8d99a6", "#b5739d", "#3c5a78", "#c9a227")
