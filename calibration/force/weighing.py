"""Weighs known forces with the robot's own sensor: the arm stands without power, weights are put on."""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.force.plateaus import Plateaus, plateaus_of
from calibration.still import StillRobot
from robot_io.errors import InputError
from robot_io.session import Session
from robot_io.types import Status

EVENT = "reference_force"


def weigh(
    still: StillRobot,
    forces_n: Sequence[float],
    place: Callable[[int, float], None],
    *,
    settle_s: float,
    measure_s: float,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Read the sensor under one force after the other; the records of each are numbered as a run.

    `place` sees to it that force number i [N], positive in compression, is there, however long that takes.
    Each then settles and is measured for so long [s]. `progress` is called with the share that is done.

    Raises:
        SafetyTripError: a sample is missing, old or beyond a limit.
        KeyboardInterrupt: the user stopped it.
    """
    for number, force_n in enumerate(forces_n):
        place(number, force_n)
        still.settle(settle_s)
        text = f"{force_n:.4f} N on the sensor"
        still.log.event(still.clock.now_s(), EVENT, text, {"run": number, "force_n": force_n})
        still.watch(measure_s, number)
        if progress:
            progress((number + 1) / len(forces_n))


def read_weighing(session: Session) -> Plateaus:
    """Plateaus of a session that `weigh` logged; `InputError` if it is no such session."""
    forces_n = {e.data["run"]: float(e.data["force_n"]) for e in session.events if e.kind == EVENT and e.data}
    if not forces_n:
        raise InputError(f"{session.path}: no reference forces in it: it is not from palpate calibrate force")
    ticks = session.samples("tick")
    fresh = ticks.select(ticks["force_status"] == Status.OK)
    pieces = [fresh["force_n"][fresh["run"] == run] for run in forces_n]
    whole = [number for number, piece in enumerate(pieces) if len(piece) >= 3]
    levels = np.array(list(forces_n.values()))[whole]
    return plateaus_of(levels.tolist(), [pieces[number] for number in whole])
