"""The fault matrix as data: faults of devices, and their required outcomes.

The tests hold every row against what happens; `docs/make_fault_matrix.py` writes the same rows down.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from math import ceil
from pathlib import Path

from palpate.robot_io.guard import Limits
from palpate.sim_backend.emulators import Fault, FaultKind
from tests.wire.parts import (
    BOTA,
    CELL,
    CUBEMARS,
    DAMIAO,
    DYNAMIXEL_PAIR,
    FEETECH_PAIR,
    LINES,
    MARK10,
    MOTEUS,
    NET_FT,
    ODRIVE,
    ROBSTRIDE,
    ROOT,
    SO101,
)

TICK_S = 1e-3
MOVING_S, FAST_S, PRESSING_S = 0.15, 0.5, 1.52  # where the probing run is then
SPARE_TICKS = 2  # beyond its limit, for every row that gives no reason to take longer
DYNAMIXEL = ROOT / "robots" / "dynamixel_3dof.yaml"


@dataclass(frozen=True)
class Family:
    """Devices of one kind."""

    title: str  # for people
    robot: Path  # robot file with such devices
    bus: str  # their bus in it
    age_ms: int  # age limit of their samples in the robot file
    changes: tuple[tuple[str, str], ...] = ()  # to the robot file
    # How much longer than others its arm takes to be activated: watchdogs are left to expire.
    late_s: float = 0.0
    tick_ms: int = 1  # length of its tick
    speed_m_s: float = 0.12  # of the probing run


FAMILIES = {
    "dynamixel": Family("Dynamixel", DYNAMIXEL, "motors", 5),
    "odrive": Family("ODrive, CAN", ODRIVE, "motors", 5, late_s=0.062),
    "mit": Family("MIT mode, CubeMars, CAN", CUBEMARS, "motors", 5, late_s=0.16),
    "damiao": Family("MIT mode, Damiao, CAN", DAMIAO, "motors", 5),
    "robstride": Family("MIT mode, Robstride, CAN", ROBSTRIDE, "motors", 5, late_s=0.15),
    "moteus": Family("moteus, CAN FD", MOTEUS, "motors", 5, late_s=0.16),
    "feetech": Family("Feetech", SO101, "motors", 13, tick_ms=4, speed_m_s=0.03),
    "dynamixel_pair": Family("Dynamixel, two servos on a joint", DYNAMIXEL, "motors", 5, (DYNAMIXEL_PAIR,)),
    "feetech_pair": Family(
        "Feetech, two servos on a joint", SO101, "motors", 13, (FEETECH_PAIR,), tick_ms=4, speed_m_s=0.03
    ),
    "loadstar": Family("Loadstar, serial", ODRIVE, "load_cell", 10, late_s=0.062),
    "lorenz": Family("Lorenz, serial", CUBEMARS, "load_cell", 5, late_s=0.16),
    "lines": Family("line parser, serial", ODRIVE, "load_cell", 10, (LINES,), late_s=0.062),
    "mark10": Family("Mark-10, serial, polled", ODRIVE, "load_cell", 10, (MARK10,), late_s=0.062),
    "net_ft": Family("ATI Net F/T, UDP", ODRIVE, "load_cell", 10, NET_FT, late_s=0.062),
    "bota": Family("Bota, serial", ODRIVE, "load_cell", 10, BOTA, late_s=0.082),
    "cell": Family("load cell on a microcontroller, serial", ODRIVE, "load_cell", 10, (CELL,), late_s=0.062),
}


class ProgramFault(StrEnum):
    """What goes wrong in the program itself."""

    EXCEPTION = "controller exception"
    CTRL_C = "Ctrl-C"
    TERMINATED = "SIGTERM"
    KILLED = "program killed"
    HELD_UP = "program held up for 0.5 s"
    CLOCK_BACK = "wall clock set back by 20 ms"
    DISK_FULL = "log disk full"
    VIEWER_GONE = "viewer gone"


@dataclass(frozen=True)
class Row:
    """One fault."""

    family: str  # key of `FAMILIES`
    name: str  # of the fault, for people
    fault: Fault | ProgramFault  # what goes wrong
    at_s: float  # when [s]
    ticks: int | None  # from the fault until the guard has the arm, at most; None: the arm goes on
    # From the fault until the drives are without torque, at most [ms]; None: the arm goes on.
    off_ms: float | None
    reads: str = ""  # what the user reads, among other things
    because: str = ""  # why it takes longer than its limit and two ticks
    # Which limit of the robot file it is that the fault exceeds, by its
    # key, or a force in words; None: the age of the samples.
    limit: str | None = None
    changes: tuple[tuple[str, str], ...] = ()  # to the robot file, beside those of the family

    @property
    def label(self) -> str:
        """For the name of its test."""
        return f"{self.family}, {self.name}"

    def later(self, by_s: float) -> "Row":
        """The same fault, at another time."""
        at_s, fault = self.at_s + by_s, self.fault
        if isinstance(fault, Fault):
            fault = fault.model_copy(update={"from_s": at_s})
        return replace(self, at_s=at_s, fault=fault)

    @property
    def limit_ms(self) -> int:
        """What its limit is; 0 where somebody says at once what is wrong [ms]."""
        if self.limit in Limits.model_fields:
            return round(1e3 * Limits.model_fields[self.limit].default)
        return FAMILIES[self.family].age_ms if (self.ticks or 0) > SPARE_TICKS else 0

    @property
    def prompt_ticks(self) -> int:
        """What it may take without a reason, in ticks."""
        return ceil(self.limit_ms / FAMILIES[self.family].tick_ms) + SPARE_TICKS


K = FaultKind
_NO_CHECKSUM = (
    "a line has no checksum, so a corrupted line may still hold a number, which counts as a reading. Once a "
    "line is not a number, all readings are invalid. The table gives the slowest of sixteen random sequences"
)
_CONFIRMED = (
    "a reading that jumps by more than 1 % of the capacity counts only once the next one confirms it, "
    "here 2 ms later, because a lost byte must not look like a force"
)
_RARE = "a sample comes every 3.1 ms"
_ELEVEN = f"{_RARE}, and eleven consecutive samples must be equal"
_CONTRADICTED = (
    "a negative force may be right. The sensor is found faulty once it shows a pull of more than 2 N while "
    "the joint torques show a push of more than 2 N"
)
_HEARTBEAT = "an axis reports its state with its next heartbeat, at most 10 ms later"
_CUT_OFF = "nothing reaches the drives, so their watchdogs switch the torque off"
HOLDS = (
    "these servos have no watchdog. They hold the last goal, so the arm stays where it is until its "
    "supply is switched off"
)
LAST_SEEN = (
    "these servos hold their last known position while the arm is braked, and then switch the torque "
    "off: 296 ms after the tick of the trip, 2.4 ms in which the last read waits for an answer, and 0.6 "
    "ms for the frame"
)
_SLOWLY = (
    "the arm moves slowly, so its reference takes this long to exceed the encoder steps and the tracking "
    "error"
)
_WAITS = (
    "the whole program is suspended. These servos hold their last goal until it continues, and then "
    "switch the torque off"
)
_IDLE = (
    "the tool hangs straight down and its drive gets no torque command, so a missing torque does no harm "
    "until the arm presses"
)
_UNRESPONSIVE, _FROZEN_ENCODER, _FROZEN_FORCE = "unresponsive_drive_s", "stuck_encoder_s", "stuck_force_s"
BRAKED = 310.0  # [ms]: the safe state brakes for 300
OLD, OLD_OFF = 6, 8  # an age limit of 5 ms, and the tick in which it is seen


def _feetech_off_ms(ticks: int) -> float:
    """Until Feetech servos let go, whatever the phase of the fault [ms].

    These ticks of 4 ms, and the brake's 300 ms, of which the first tick is the one of the trip. In the last
    tick the read waits for 0.6 of a tick for a servo that is silent, and the frame that lets go takes 0.6 ms.
    """
    return 4 * ticks + (300 - 4) + 0.6 * 4 + 0.6


# The fault begins after an answer at the earliest: three ticks later that is 12 ms old, and the limit is 13.
_FEETECH_OLD = (4, _feetech_off_ms(4))

# name, kind, details, then ticks, off [ms], reads (and because), for each family.
_MOTORS: tuple[tuple[str, FaultKind, dict[str, float]], ...] = (
    ("reply lost", K.DROP, {}),
    ("reply late", K.DELAY, {"delay_s": 0.05}),
    ("reply corrupt", K.CORRUPT, {}),
    ("reply duplicated", K.DUPLICATE, {}),
    ("replies out of order", K.REORDER, {}),
    ("reply with a wrong id", K.WRONG_ID, {}),
    ("alert", K.ALERT, {"times": 1}),
    ("reboot, away for 0.3 s", K.REBOOT, {"times": 1, "delay_s": 0.3}),
    ("reboot, back at once", K.REBOOT, {"times": 1, "delay_s": 0.001}),
    ("unplugged", K.UNPLUG, {}),
    ("stuck encoder", K.STUCK, {}),
)
GOES_ON = (None, None)
_STUCK_ENCODER = (22, BRAKED + 22, "encoder of joint 1: stuck at", "", _FROZEN_ENCODER)


def _mit_mode(
    sizes: str, back_at_once: tuple[object, ...], hot: str = "MOSFET over temperature", who: str = "motor"
) -> tuple[tuple[object, ...], ...]:
    """Ends of motors in MIT mode, whose states have so many bytes."""
    silent = "joint 3 (motor 3): nothing valid for"
    return (
        (OLD, OLD_OFF, silent),
        (OLD, BRAKED, silent),
        (OLD, OLD_OFF, f"last problem: {who} state has 3 bytes, expected {sizes}"),
        GOES_ON,
        GOES_ON,
        (OLD, OLD_OFF, silent),
        (2, BRAKED, f"joint 3 (motor 3): {hot}"),
        (OLD, BRAKED, silent),
        back_at_once,
        (2, 102, "bus-off, the adapter has left the bus", _CUT_OFF),
        _STUCK_ENCODER,
    )


_LEFT = (3, BRAKED, "joint 3 (motor 3): has left motor mode; has it restarted?")
_MOTOR_ROWS = {
    "dynamixel": (
        (OLD, OLD_OFF, "servo 3 did not answer in time"),
        (OLD, OLD_OFF, "did not answer in time"),
        (OLD, OLD_OFF, "CRC mismatch"),
        GOES_ON,
        (OLD, OLD_OFF, "answered in place of servo"),
        (OLD, OLD_OFF, "servo 103 answered in place of servo 3"),
        (2, 3, "servo 3 (joint 3): has switched its torque off (hardware error: overload)"),
        (OLD, OLD_OFF, "servo 3 did not answer in time"),
        (2, 3, "servo 3 (joint 3): has lost its settings; it has restarted"),
        (2, 62, "the port has failed", _CUT_OFF),
        _STUCK_ENCODER,
    ),
    "odrive": (
        (OLD, OLD_OFF, "joint 3 (node 2): nothing valid for"),
        (OLD, BRAKED, "joint 3 (node 2): nothing valid for"),
        (OLD, OLD_OFF, "last problem: motor torque has 3 bytes, expected 8"),
        GOES_ON,
        GOES_ON,
        (OLD, OLD_OFF, "joint 3 (node 2): nothing valid for"),
        (11, BRAKED + 11, "joint 3 (node 2): IDLE INVERTER_OVER_TEMP", _HEARTBEAT, "one heartbeat"),
        (OLD, BRAKED, "joint 3 (node 2): nothing valid for"),
        (11, BRAKED + 11, "joint 3 (node 2): left closed-loop control (IDLE)", _HEARTBEAT, "one heartbeat"),
        (2, 52, "bus-off, the adapter has left the bus", _CUT_OFF),
        _STUCK_ENCODER,
    ),
    "mit": _mit_mode("6 or 8", (12, BRAKED + 12, "joint 1: its drive exerts", "", _UNRESPONSIVE)),
    "damiao": _mit_mode("8", _LEFT),
    "robstride": _mit_mode("8", _LEFT, "over temperature"),
    "moteus": _mit_mode("24", _LEFT, "over temperature", "moteus"),
    "feetech": (
        (*_FEETECH_OLD, "servo 4 did not answer in time", LAST_SEEN),
        (*_FEETECH_OLD, "did not answer in time", LAST_SEEN),
        (*_FEETECH_OLD, "servo 4 did not answer in time", LAST_SEEN),
        GOES_ON,
        GOES_ON,
        (*_FEETECH_OLD, "servo 4 did not answer in time", LAST_SEEN),
        (2, BRAKED + 2, "servo 4 (joint 3): error: overload"),
        (*_FEETECH_OLD, "servo 4 did not answer in time", LAST_SEEN),
        (2, BRAKED, "servo 4: torque limit is 1000 instead of 999; it has restarted"),
        (2, None, "the port has failed", HOLDS),
        (103, BRAKED + 400, "encoder of joint 1: stuck at", _SLOWLY, _FROZEN_ENCODER),
    ),
}
# One of the two servos of joint 1, beside what is the same with one: device, name, kind, when, ends.
_APART, _PULL, _TOLERANCE = "(joint 1) stand 0.1", "(joint 1) exert", "0.035 rad"
_TURNS = "the joint must turn by the permitted difference before its two encoders differ by as much"
_DUTY = (
    "these servos report a duty cycle instead of a torque. A motor that exerts the opposite is detected only "
    "because the arm does not follow its reference"
)
_OLD_GOAL = (
    "palpate accepts an answer that repeats any of the last 32 goals. The repeated value may be sent for up "
    "to 10 more ticks, because a goal moves by one count in 5 ticks and may go back by one. After that, the "
    "samples exceed their age limit within 4 ticks"
)
_PAIR_ROWS = {
    "dynamixel_pair": (
        (4, "second servo silent", K.DROP, MOVING_S, (OLD, OLD_OFF, "servo 4 did not answer in time")),
        (4, "second servo overloaded", K.ALERT, MOVING_S, (2, 3, "servo 4 (joint 1, second): has switched")),
        (1, "first servo's horn slips", K.SLIPPED, MOVING_S, (2, 3, _APART)),
        (4, "second servo's horn slips", K.SLIPPED, MOVING_S, (2, 3, _APART)),
        (4, "second servo's encoder stuck", K.STUCK, FAST_S, (60, 62, _APART[:-1], _TURNS, _TOLERANCE)),
        (4, "second servo exerts nothing", K.LIMP, FAST_S, (12, BRAKED + 12, _PULL, "", _UNRESPONSIVE)),
        (
            4,
            "second servo opposes the first",
            K.REVERSED,
            FAST_S,
            (12, BRAKED + 12, _PULL, "", _UNRESPONSIVE),
        ),
    ),
    "feetech_pair": (
        (7, "second servo silent", K.DROP, MOVING_S, (*_FEETECH_OLD, "servo 7 did not answer", LAST_SEEN)),
        (
            7,
            "second servo overloaded",
            K.ALERT,
            MOVING_S,
            (2, BRAKED + 2, "servo 7 (joint 1, second): error"),
        ),
        (2, "first servo's horn slips", K.SLIPPED, MOVING_S, (2, BRAKED + 2, _APART, LAST_SEEN)),
        (7, "second servo's horn slips", K.SLIPPED, MOVING_S, (2, BRAKED + 2, _APART, LAST_SEEN)),
        (7, "second servo's encoder stuck", K.STUCK, FAST_S, (86, 640, _APART[:-1], _TURNS, _TOLERANCE)),
        (
            7,
            "second servo ignores goals",
            K.DEAF,
            FAST_S,
            (32 + 10 + 4, _feetech_off_ms(32 + 10 + 4), "servo 7: goal position is", _OLD_GOAL),
        ),
        (7, "second servo exerts nothing", K.LIMP, MOVING_S, GOES_ON),
        (
            7,
            "second servo opposes the first",
            K.REVERSED,
            MOVING_S,
            (49, 490, "joint 1 is 0.15", _DUTY, "0.15 rad"),
        ),
    ),
}
_ASKED = ("mit", "damiao", "robstride", "moteus")
_NUMBERS = {
    "dynamixel": (1, 2, 3),
    "odrive": (0, 1, 2),
    **dict.fromkeys(_ASKED, (1, 2, 3)),
    "feetech": (2, 3, 4),
}  # of the devices, by joint

_FORCE: tuple[tuple[str, FaultKind, dict[str, float]], ...] = (
    ("silent", K.DROP, {}),
    ("readings late", K.DELAY, {"delay_s": 0.05}),
    ("readings corrupt", K.CORRUPT, {}),
    ("readings duplicated", K.DUPLICATE, {}),
    ("readings out of order", K.REORDER, {}),
    ("reboot", K.REBOOT, {"times": 1, "delay_s": 0.3}),
    ("unplugged", K.UNPLUG, {}),
    ("not a number", K.NOT_A_NUMBER, {}),
    ("saturated", K.SATURATED, {}),
    ("reversed", K.REVERSED, {}),
    ("stuck", K.STUCK, {}),
)
_SILENT = (11, BRAKED + 5, "no reading for")
_STUCK = (22, BRAKED + 22, "force sensor: stuck at", "", _FROZEN_FORCE)


def _streamed(
    corrupt_ticks: int, reversed_ticks: int, reordered: tuple[object, ...] = GOES_ON
) -> tuple[tuple[object, ...], ...]:
    """Ends of a sensor that streams lines; how soon digits that are flipped are told is a matter of luck."""
    return (
        _SILENT,
        _SILENT,
        (corrupt_ticks, BRAKED + corrupt_ticks, "no reading for", _NO_CHECKSUM),
        GOES_ON,
        reordered,
        _SILENT,
        (2, BRAKED, "the port was unplugged"),
        _SILENT,
        (4, BRAKED, "force sensor: at the end of its range", _CONFIRMED, "one reading"),
        (reversed_ticks, BRAKED + reversed_ticks, "does the sensor work", _CONTRADICTED, "2 N"),
        _STUCK,
    )


_FORCE_ROWS = {
    "loadstar": _streamed(13, 30),
    "lorenz": (
        *[(OLD, BRAKED, "no reading for")] * 2,
        (13, BRAKED + 13, "no reading for", _NO_CHECKSUM),
        *[(OLD, BRAKED, "no reading for")] * 3,
        (2, BRAKED, "the port was unplugged"),
        *[(2, BRAKED, "force sensor: at the end of its range")] * 2,
        (17, BRAKED + 17, "does the sensor work", _CONTRADICTED, "2 N"),
        _STUCK,
    ),
    "lines": _streamed(17, 22),
    "mark10": _streamed(17, 30, _SILENT),
    "net_ft": (
        *[(11, BRAKED + 5, "no reading for")] * 3,
        GOES_ON,
        GOES_ON,
        *[(11, BRAKED + 5, "no reading for")] * 2,
        (2, BRAKED + 2, "the sensor says 'broken gage (status 0x80000004)'"),
        (2, BRAKED + 2, "the sensor says 'force or torque out of range (status 0xc0000000)'"),
        (24, BRAKED + 24, "does the sensor work", _CONTRADICTED, "2 N"),
        _STUCK,
    ),
    "bota": (
        *[(11, BRAKED + 5, "no reading for")] * 3,
        GOES_ON,
        GOES_ON,
        (11, BRAKED + 5, "no reading for"),
        (2, BRAKED, "the port was unplugged"),
        (3, BRAKED + 2, "the sensor says 'invalid measurements'"),
        (3, BRAKED + 2, "force sensor: at the end of its range"),
        (24, BRAKED + 24, "does the sensor work", _CONTRADICTED, "2 N"),
        _STUCK,
    ),
    "cell": (
        *[(11, BRAKED + 5, "no reading for")] * 3,
        GOES_ON,
        GOES_ON,
        (11, BRAKED + 5, "no reading for"),
        (2, BRAKED, "the port was unplugged"),
        (4, BRAKED, "the cell says 'fault converter'", _RARE, "one reading"),
        (4, BRAKED, "force sensor: at the end of its range", _RARE, "one reading"),
        (24, BRAKED + 24, "does the sensor work", _CONTRADICTED, "2 N"),
        (36, BRAKED + 24, "force sensor: stuck at", _ELEVEN, _FROZEN_FORCE),
    ),
}

_HELD_UP = (
    "the whole program is suspended. The drives' watchdogs switch the torque off in this time, and the "
    "delayed command is not sent"
)
_PROGRAM_ROWS = {
    ProgramFault.EXCEPTION: (2, BRAKED, "the task: ZeroDivisionError: float division by zero"),
    ProgramFault.CTRL_C: (2, BRAKED, "interrupted by the user (SIGINT)"),
    ProgramFault.TERMINATED: (2, BRAKED, "interrupted by the user (SIGTERM)"),
    ProgramFault.CLOCK_BACK: GOES_ON,
    ProgramFault.DISK_FULL: (*GOES_ON, "is not complete: File too large"),
    ProgramFault.VIEWER_GONE: (*GOES_ON, "online estimation was switched off: BrokenPipeError"),
}
_WATCHDOG_ROWS = {  # program killed (nobody is left to read), program held up
    family: ((None, off_ms, "", _CUT_OFF), (501, off_ms, "the program was held up for 0.5", _HELD_UP))
    for family, off_ms in {"dynamixel": 62, "odrive": 52, **dict.fromkeys(_ASKED, 102)}.items()
}
_WATCHDOG_ROWS["feetech"] = ((None, None, "", HOLDS), (127, 510, "the program was held up for 0.5", _WAITS))


def rows() -> Iterator[Row]:
    """All rows, family by family."""
    for row in _rows():
        yield row.later(FAMILIES[row.family].late_s)


def _rows() -> Iterator[Row]:
    for family, expected in _MOTOR_ROWS.items():
        for (name, kind, details), ends in zip(_MOTORS, expected, strict=True):
            joint, at_s = (0, FAST_S) if kind is K.STUCK else (2, MOVING_S)
            if _HEARTBEAT in ends:
                at_s += TICK_S  # the last heartbeat has just come
            if _UNRESPONSIVE in ends:
                joint = 0  # which carries the arm
            yield _wire_row(family, name, kind, at_s, ends, details | _whose(family, kind, joint))
        if family == "mit":
            yield from _mit_rows()
        for what, ends in _PROGRAM_ROWS.items():
            yield Row(
                family, what.value, what, 2 * MOVING_S if what is ProgramFault.DISK_FULL else MOVING_S, *ends
            )
        killed, held_up = _WATCHDOG_ROWS[family]
        yield Row(family, ProgramFault.KILLED.value, ProgramFault.KILLED, MOVING_S, *killed)
        yield Row(family, ProgramFault.HELD_UP.value, ProgramFault.HELD_UP, MOVING_S, *held_up)
    for family, pair_rows in _PAIR_ROWS.items():
        for device, name, kind, at_s, ends in pair_rows:
            times = {"times": 1} if kind is K.ALERT else {}
            yield _wire_row(family, name, kind, at_s, ends, times | {"device": device})
    for family, expected in _FORCE_ROWS.items():
        for (name, kind, details), ends in zip(_FORCE, expected, strict=True):
            at_s = PRESSING_S if kind in (K.REVERSED, K.STUCK) else MOVING_S
            yield _wire_row(family, name, kind, at_s, ends, details)


def _mit_rows() -> Iterator[Row]:
    """What a motor that has restarted does is not the same for all of them."""
    name, back_at_once = "reboot, back at once", {"times": 1, "delay_s": 0.001, "device": 3}
    idle = (1680, BRAKED + 1680, "joint 3 is 0.1", _IDLE, _UNRESPONSIVE)
    yield _wire_row("mit", f"{name}; without a load", K.REBOOT, MOVING_S, idle, back_at_once)
    mute = (OLD, BRAKED, "joint 3 (motor 3): nothing valid for")
    row = _wire_row("mit", f"{name}; silent until it enters the mode", K.REBOOT, MOVING_S, mute, back_at_once)
    yield replace(row, changes=(("driver: mit_bus", "driver: mit_bus\n    ask_with: enter"),))


def _wire_row(family, name, kind, at_s, ends, details) -> Row:
    return Row(family, name, Fault(kind=kind, from_s=at_s, **details), at_s, *ends)


def _whose(family: str, kind: FaultKind, joint: int) -> dict[str, int]:
    """The device that a fault befalls; some befall the line, or all on it."""
    return {} if kind in (K.REORDER, K.UNPLUG) else {"device": _NUMBERS[family][joint]}
