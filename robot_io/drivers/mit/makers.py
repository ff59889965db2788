"""What differs between makers of MIT-mode motors, as data.

Sources: CubeMars "AK Series Actuator Driver Manual" V1.0.8, section 5.3 (table of parameter ranges, errors);
Damiao, "DM-J4310-2EC user manual" and its table of default PMAX, VMAX and TMAX.
"""

from dataclasses import dataclass
from enum import StrEnum

from robot_io.drivers.mit.protocol import MitRanges


class Maker(StrEnum):
    """Whose motors they are; all on a bus are of one."""

    CUBEMARS = "cubemars"  # and others whose firmware is the Mini Cheetah's
    DAMIAO = "damiao"


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one maker's motors speak."""

    models: dict[str, MitRanges]  # ranges of each model, as delivered
    errors: dict[int, str]  # what an error means
    encoder_fault: int | None  # the error of the encoder, if it has one
    timeout_error: int | None  # the error of a CAN timeout that has fired, which each activation clears
    # Whether a motor says in its answers whether it is in motor mode, has registers that can be read and
    # written over CAN (ranges, mode, CAN timeout), and answers under an id of its own.
    has_registers: bool


DIALECTS = {
    Maker.CUBEMARS: Dialect(
        models={
            "AK10-9": MitRanges(12.5, 50.0, 65.0),
            "AK60-6": MitRanges(12.5, 45.0, 15.0),
            "AK70-10": MitRanges(12.5, 50.0, 25.0),
            "AK80-6": MitRanges(12.5, 76.0, 12.0),
            "AK80-9": MitRanges(12.5, 50.0, 18.0),
            "AK80-64": MitRanges(12.5, 8.0, 144.0),  # the manual's column is headed AK80-80/64
            "AK80-80": MitRanges(12.5, 8.0, 144.0),
        },
        errors={
            1: "motor over temperature",
            2: "over current",
            3: "over voltage",
            4: "under voltage",
            5: "encoder fault",
            6: "MOSFET over temperature",
            7: "motor stalled",
        },
        encoder_fault=5,
        timeout_error=None,
        has_registers=False,
    ),
    Maker.DAMIAO: Dialect(
        models={
            "DM-J3507": MitRanges(12.566, 50.0, 5.0),
            "DM-J4310": MitRanges(12.5, 30.0, 10.0),
            "DM-J4340": MitRanges(12.5, 8.0, 28.0),
            "DM-J6006": MitRanges(12.5, 45.0, 20.0),
            "DM-J8006": MitRanges(12.5, 45.0, 40.0),
            "DM-J8009": MitRanges(12.5, 45.0, 54.0),
            "DM-J10010": MitRanges(12.5, 20.0, 200.0),
            "DM-J10010L": MitRanges(12.5, 25.0, 200.0),
        },
        errors={
            8: "over voltage",
            9: "under voltage",
            10: "over current",
            11: "MOSFET over temperature",
            12: "motor over temperature",
            13: "lost communication: its CAN timeout has fired",
            14: "overload",
        },
        encoder_fault=None,
        timeout_error=13,
        has_registers=True,
    ),
}


def error_name(maker: Maker, code: int) -> str:
    """What an error means."""
    return DIALECTS[maker].errors.get(code, f"unknown error {code}")
