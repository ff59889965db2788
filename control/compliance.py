"""What an object gives way by, as far as control needs to know."""

from typing import NamedTuple


class Compliance(NamedTuple):
    """Stiffness [N/m] and damping [N s/m] of an object, F = k x + c dx/dt."""

    stiffness_n_m: float
    damping_n_s_m: float
