"""Palette for every medium, legible on light and dark backgrounds; each color has one meaning."""

from palpate.control.loop.task import Phase
from palpate.estimation.kinds import Kind

# CSS drops the whole list if a name that has a word of digits is not quoted.
FONT = "Inter, 'Source Sans 3', 'Helvetica Neue', 'Liberation Sans', Arial, sans-serif"
MEASURED = "#3f86c8"
BASE = "#8d99a6"  # revision 0, and commanded values
MODEL = "#de7a26"
OTHER = "#9a6fc4"  # the second of two measurements
NOISE = "#2f9e73"
TRUTH = "#d1495b"
BAND = "#48806a"
SHADE = "rgba(128,140,155,0.18)"  # samples excluded from scoring
JOINTS = ("#3f86c8", "#de7a26", "#2f9e73", "#9a6fc4", "#d1495b", "#5aa7b5", "#a08a2e")
SPEEDS = ("#4a6fb5", "#2b9a92", "#7fae4d", "#e2a13c", "#d9662b", "#b23a5c")  # from slow to fast
RESIDUAL = ((0.0, "#2a6fb0"), (0.5, "rgba(128,140,155,0.14)"), (1.0, "#c9452f"))  # below, none, above
PHASES = {
    Phase.IDLE: "#aab4be",
    Phase.MOVE: "#93a3b3",
    Phase.APPROACH: "#7faed6",
    Phase.LOADING: "#e8a05a",
    Phase.HOLD: "#d97070",
    Phase.UNLOADING: "#7fbf9c",
    Phase.RETRACT: "#9dbcd6",
    Phase.FREE_AIR: "#b5c99a",
    Phase.STOPPED: "#8c1d18",
}
KINDS = {  # colors of effect kinds in an error budget; noise has the color of the noise level
    Kind.ELASTIC_SHAPE: "#3f86c8",
    Kind.RATE_DEPENDENCE: "#5aa7b5",
    Kind.FRICTION: "#de7a26",
    Kind.TIME_MEMORY: "#9a6fc4",
    Kind.INERTIA: "#7a86d1",
    Kind.PERIODIC: "#c9a227",
    Kind.GRAVITY_LOAD: "#8a6d4b",
    Kind.CONTACT_GEOMETRY: "#d1495b",
    Kind.SENSOR_DYNAMICS: "#c77fae",
    Kind.SENSOR_STATICS: "#a3568c",
    Kind.DRIFT: "#86a35a",
    Kind.RUN_DIFFERENCES: "#6f8aa3",
    Kind.RECORDED_CONTEXT: "#4f9e9a",
    Kind.OTHER: "#5f6b78",
}
UNEXPLAINED = "#aab4be"
UNKNOWN_PHASE = ("unknown", "#9aa5b1")


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue (0 to 255) of "#rrggbb"."""
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def speed_colors(words: list[str]) -> dict[str, str]:
    """Return a color for each speed, from slow to fast.

    Args:
        words: description of each speed, from slow to fast.
    """
    last = max(len(words) - 1, 1)
    return {word: SPEEDS[round(i * (len(SPEEDS) - 1) / last)] for i, word in enumerate(words)}


def phase(number: int) -> tuple[str, str]:
    """Return name and color of a phase.

    Args:
        number: number of the phase in the session's column.
    """
    if number not in set(Phase):
        return UNKNOWN_PHASE
    return Phase(number).name.lower().replace("_", " "), PHASES.get(Phase(number), UNKNOWN_PHASE[1])
