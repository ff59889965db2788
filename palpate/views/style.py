"""One look for every picture: palette, type, rules. Colours mean the same thing everywhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from matplotlib import font_manager, rc_context
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure

from control.loop.phases import Phase

INK = "#1d2733"
MUTED = "#66727f"
RULE = "#e3e8ed"
PAPER = "#ffffff"

MEASURED = "#2a6fb0"
COMMANDED = "#c3ccd5"
MODEL = "#1d2733"
TRUTH = "#c4453a"
DESIRED = "#c4453a"
BAND = "#2a6fb0"
JOINTS = ("#2a6fb0", "#d9822b", "#3a8f6b", "#8a5fb0", "#b0506b", "#5f7d8a", "#a08a2e")
SLOW_TO_FAST = LinearSegmentedColormap.from_list("speed", ["#27456b", "#2b9a92", "#e2a13c"])

PHASES = {
    Phase.IDLE: "#d5dbe1",
    Phase.MOVE: "#c3ced9",
    Phase.APPROACH: "#a9c6e3",
    Phase.LOADING: "#e8b27a",
    Phase.HOLD: "#d98c8c",
    Phase.UNLOADING: "#a8d0bb",
    Phase.RETRACT: "#c8d9e8",
    Phase.FREE_AIR: "#dfe8d5",
    Phase.STOPPED: "#8c1d18",
}

UNKNOWN = "unknown"
PHASE_BY_NAME = {UNKNOWN: RULE} | {
    phase.name.lower().replace("_", " "): color for phase, color in PHASES.items()
}

FONTS = ("Inter", "Source Sans 3", "Helvetica Neue", "Liberation Sans", "Arial", "DejaVu Sans")
DPI = 160


def phase_name(phase: int) -> str:
    """The phase's name as a person reads it."""
    return Phase(phase).name.lower().replace("_", " ") if phase in set(Phase) else UNKNOWN


def phase_color(phase: int) -> str:
    """The phase's colour."""
    return PHASES.get(Phase(phase), RULE) if phase in set(Phase) else RULE


def joint_color(joint: int) -> str:
    """Colour of joint number `joint` (from 0), starting over when the palette ends."""
    return JOINTS[joint % len(JOINTS)]


def speed_colors(count: int) -> list[str]:
    """Colours for `count` speeds from slow to fast."""
    return [to_hex(SLOW_TO_FAST(i / max(count - 1, 1))) for i in range(count)]


@contextmanager
def house_style() -> Iterator[None]:
    """Inside this block figures are drawn in the house style; nothing global is changed."""
    with rc_context(_settings()):
        yield


def title(figure: Figure, text: str, remark: str) -> None:
    """A headline that says what is seen, and a quieter line below it; both above the axes, flush left."""
    height_in = figure.get_size_inches()[1]
    figure.text(0.012, 1 - 0.16 / height_in, text, size=12.5, weight="bold", color=INK, va="top")
    figure.text(0.012, 1 - 0.42 / height_in, remark, size=9, color=MUTED, va="top")
    figure.get_layout_engine().set(rect=(0.004, 0.008, 0.985, 0.992 - 0.66 / height_in))  # type: ignore[union-attr,call-arg]


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure that lays itself out."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained", facecolor=PAPER)


def _settings() -> dict[Any, Any]:
    installed = set(font_manager.get_font_names())
    return {
        "font.family": [next((name for name in FONTS if name in installed), "DejaVu Sans")],
        "font.size": 9.5,
        "text.color": INK,
        "axes.labelcolor": INK,
        "axes.edgecolor": "#aeb8c2",
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 9.5,
        "axes.unicode_minus": True,
        "grid.color": RULE,
        "grid.linewidth": 0.8,
        "xtick.color": MUTED,
        "ytick.color": MUTED,
        "xtick.labelcolor": INK,
        "ytick.labelcolor": INK,
        "xtick.major.size": 0,
        "ytick.major.size": 0,
        "lines.linewidth": 1.4,
        "lines.solid_capstyle": "round",
        "legend.frameon": False,
        "legend.fontsize": 9,
        "legend.handlelength": 1.6,
        "savefig.facecolor": PAPER,
    }
