"""What the arm is doing in a tick. The numbers are written to session files: add new ones at the end."""

from enum import IntEnum


class Phase(IntEnum):
    """Phase of a task, as logged in every tick."""

    IDLE = 0  # active, holding still, nothing asked
    MOVE = 1  # free motion between targets
    APPROACH = 2  # towards the object, not touching yet
    LOADING = 3  # in contact, moving in
    HOLD = 4  # in contact, force held
    UNLOADING = 5  # in contact, moving out
    RETRACT = 6  # contact lost, moving away from the object
    FREE_AIR = 7  # on purpose without contact, for the noise floor and the arm's own dynamics
    STOPPED = 8  # the safe state: the guard commands, not the task
