"""Small drawings as SVG, which a browser shows before it has loaded anything."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.render import palette
from palpate.render.thinning import peaks
from robot_io.session import Session
from robot_io.types import FloatArray

_TICKS = "tick"
_MOST_POINTS = 600  # of a curve


def picture(
    x: FloatArray, curves: Sequence[tuple[FloatArray, str]], width: int = 72, height: int = 44
) -> str:
    """A small drawing of curves (n,) over x (n,), as SVG without axes."""
    every = np.concatenate([y for y, _ in curves])
    low, high = float(every.min()), float(every.max())
    left, right = float(x.min()), float(x.max())
    paths = []
    for y, color in curves:
        across = 2 + (width - 4) * (x - left) / ((right - left) or 1.0)
        down = height - 2 - (height - 4) * (y - low) / ((high - low) or 1.0)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))
        paths.append(f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="1.4"/>')
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'<svg {size} aria-hidden="true">{"".join(paths)}</svg>'


def raw_curves(file: Path) -> str:
    """Force and torques of a probing over time, as they were measured; empty for other files.

    Raises:
        SessionError: it is a session that cannot be read.
    """
    if file.suffix != ".mcap":
        return ""
    found = Session.open(file)
    if _TICKS not in found.stream_names or not len(ticks := found.samples(_TICKS)):
        return ""
    time_s, torques = ticks["time_s"], ticks.vector("torque_measured_nm").T
    colors = [palette.JOINTS[n % len(palette.JOINTS)] for n in range(len(torques))]
    return _panel("force [N]", time_s, [(ticks["force_n"], palette.MEASURED)]) + _panel(
        "joint torques [N m]", time_s, list(zip(torques, colors, strict=True))
    )


def _panel(title: str, time_s: FloatArray, curves: Sequence[tuple[FloatArray, str]]) -> str:
    rows = np.unique(np.concatenate([peaks(y, _MOST_POINTS) for y, _ in curves]))
    rows = rows[np.isfinite([y[rows] for y, _ in curves]).all(axis=0)]
    if not len(rows):
        return ""
    shown = [(y[rows], color) for y, color in curves]
    low, high = min(y.min() for y, _ in shown), max(y.max() for y, _ in shown)
    said = f"{title} from {low:.3g} to {high:.3g}, over {np.ptp(time_s[rows]):.1f} s, as measured"
    return f"<h2>{said}</h2>{picture(time_s[rows], shown, 1000, 200)}"
