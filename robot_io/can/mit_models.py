"""Ranges of motors that speak the MIT protocol; a number on the wire is a share of its range.

Source: CubeMars "AK Series Actuator Driver Manual" V1.0.8, section 5.3, table of parameter ranges. The same
table holds KP 0 to 500 and KD 0 to 5 for all of them. A motor that was given other ranges states them in the
robot file.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MitRanges:
    """What the ends of the wire's numbers mean; each range goes from minus to plus the value.

    Attributes:
        position_rad: of the output shaft [rad].
        velocity_rad_s: of the output shaft [rad/s].
        torque_nm: at the output shaft [N m].
    """

    position_rad: float
    velocity_rad_s: float
    torque_nm: float


MIT_MODELS: dict[str, MitRanges] = {
    "AK10-9": MitRanges(12.5, 50.0, 65.0),
    "AK60-6": MitRanges(12.5, 45.0, 15.0),
    "AK70-10": MitRanges(12.5, 50.0, 25.0),
    "AK80-6": MitRanges(12.5, 76.0, 12.0),
    "AK80-9": MitRanges(12.5, 50.0, 18.0),
    "AK80-64": MitRanges(12.5, 8.0, 144.0),  # the manual's column is headed AK80-80/64
    "AK80-80": MitRanges(12.5, 8.0, 144.0),
}

MAX_STIFFNESS = 500.0  # KP [N m/rad]
MAX_DAMPING = 5.0  # KD [N m s/rad]

MIT_ERRORS: dict[int, str] = {
    1: "motor over temperature",
    2: "over current",
    3: "over voltage",
    4: "under voltage",
    5: "encoder fault",
    6: "MOSFET over temperature",
    7: "motor stalled",
}


def mit_error_name(code: int) -> str:
    """What an error byte means."""
    return MIT_ERRORS.get(code, f"unknown error {code}")
