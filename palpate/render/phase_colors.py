"""The colour of each phase; apart from the palette, for the controller that names them is slow to import."""

from control.loop.phases import Phase

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
UNKNOWN_PHASE = ("unknown", "#9aa5b1")


def phase(number: int) -> tuple[str, str]:
    """Name and colour of a phase."""
    if number not in set(Phase):
        return UNKNOWN_PHASE
    return Phase(number).name.lower().replace("_", " "), PHASES.get(Phase(number), UNKNOWN_PHASE[1])
