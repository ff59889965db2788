"""Stiffness and damping: found online tick by tick, found afterwards with its interval, and true."""

import numpy as np
import rerun as rr

from palpate.views import colors
from palpate.views.recording.entities import DAMPING, STIFFNESS, send_lines
from palpate.views.scene import Scene
from robot_io.types import FloatArray

PARAMETERS = {STIFFNESS: ("stiffness.k", "stiffness_n_m"), DAMPING: ("damping.c", "damping_n_s_m")}

LOWEST, HIGHEST = 0.7, 1.8  # of the levels: the range that is shown, with room for the legend above


def log(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the online estimates as curves, the others as level lines over the whole session."""
    ends = scene.time_s[[0, -1]]
    for entity, (name, column) in PARAMETERS.items():
        online = {"online": (scene.ticks[column], colors.MEASURED)}
        send_lines(recording, f"{entity}/online", scene.time_s, online, (4.0,))
        found = scene.found(name)
        if found is not None:
            lower, upper = found.interval
            band = {
                "afterwards": (_level(found.value), colors.FINAL),
                "95 % from": (_level(lower), colors.BAND),
                "95 % to": (_level(upper), colors.BAND),
            }
            send_lines(recording, f"{entity}/afterwards", ends, band, (2.0, 1.0, 1.0))
        if name in scene.truth:
            truth = {"truth": (_level(scene.truth[name]), colors.TRUTH)}
            send_lines(recording, f"{entity}/truth", ends, truth, (1.0,))


def shown_range(scene: Scene, entity: str) -> tuple[float, float] | None:
    """Vertical range that shows where an estimate ends up, rather than its first wild guesses."""
    name, column = PARAMETERS[entity]
    levels = [scene.truth[name]] if name in scene.truth else []
    found = scene.found(name)
    levels += [found.value] if found is not None else []
    online = scene.ticks[column][np.isfinite(scene.ticks[column])]
    levels += [float(np.median(online))] if len(online) else []
    return (LOWEST * min(levels), HIGHEST * max(levels)) if levels and min(levels) > 0 else None


def _level(value: float) -> FloatArray:
    return np.full(2, value)
