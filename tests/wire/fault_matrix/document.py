"""The fault matrix as a page of the docs."""

from collections.abc import Sequence

from palpate.robot_io.guard import Limits
from tests.wire.fault_matrix.rows import FAMILIES, ProgramFault, Row
from tests.wire.parts import ROOT

DOCUMENT = ROOT / "docs" / "reference" / "fault-matrix.md"
_HEAD = """\
# What goes wrong, and what the arm then does

Made from the rows of `tests/wire/fault_matrix/rows.py` by `docs/make_fault_matrix.py`. The tests let each of
these faults happen to the real drivers, on emulated devices in lock-step, in a probing run at 1 kHz; the
Feetech arm runs at 250 Hz.

- **arm**: *stops* is the guard's safe state. The joints are braked for 300 ms and then let go, or let go at
  once where nobody knows how they move; `palpate probe` also holds and lowers the arm's weight meanwhile.
  *goes on*: no harm is done.
- **limit**: how long the fault may last, from the section `limits` of the robot file. Mostly that is the age
  of the device's samples; a check that compares them with each other has a limit of its own, which is
  named. Without a limit somebody says at once what is wrong.
- **ticks**: from the fault to the tick that commands the safe state, at most. Without a reason given below
  that is the limit and two ticks.
- **off**: from the fault until no drive exerts torque any more, at most.
- **reads**: part of the line that the user reads, and that is among the session's events. In every row the
  session can be read up to the fault or further.

Simulated ticks are the same on every machine, however busy it is.
"""
_REASONS = """
## Slower than the limit and two ticks

"""
_TAIL = """
## Not in the table

- The arm with two Feetech servos on its shoulder goes on with one of them that exerts nothing: these servos
  show a duty cycle and no torque, the other carries the joint, and the force comes from the load cell.
- A serial force sensor has no id that could be another's, and no alert.
- A force sensor that freezes while the arm stands, or whose steps are as coarse as its noise, looks like a
  sound one: `stuck_force_s` begins to count when the arm has moved, and joint torques contradict such a
  sensor later, at a few newtons.
- No viewer hangs on the loop: recordings are made of the session afterwards. *viewer gone* stands for
  whatever looks on while the arm moves, the online estimator, and fails.
- Samples are dated by the machine's monotonic clock, which nobody can set. If it were set back, the loop
  would wait until it has caught up. CAN motors that are asked are asked nothing meanwhile, and the arm stops
  by the age of their samples. If it jumps forward, the program is held up.
- A killed program leaves the session that it had written, to the last tick: the writer is another process.
"""


def document(rows: Sequence[Row]) -> str:
    """The whole page."""
    reasons = list(dict.fromkeys(row.because for row in rows if row.because))
    tables = (_table([row for row in rows if row.family == family], reasons) for family in FAMILIES)
    listed = "".join(f"{number}. {reason}.\n" for number, reason in enumerate(reasons, 1))
    return _HEAD + "".join(tables) + _REASONS + listed + _TAIL


def _table(rows: Sequence[Row], reasons: Sequence[str]) -> str:
    family = FAMILIES[rows[0].family]
    tick = f", ticks of {family.tick_ms} ms" if family.tick_ms > 1 else ""
    title = f"\n## {family.title} (age limit {family.age_ms} ms{tick})\n"
    lines = [title, "| fault | arm | limit | ticks | off | reads |", "|---|---|---|---|---|---|"]
    return "\n".join([*lines, *(_line(row, reasons) for row in rows)]) + "\n"


def _line(row: Row, reasons: Sequence[str]) -> str:
    reason = f" [{reasons.index(row.because) + 1}]" if row.because else ""
    ticks = "" if row.ticks is None else str(row.ticks)
    off = "" if row.off_ms is None else f"{row.off_ms:g} ms"
    return f"| {row.name} | {_arm(row)}{reason} | {_limit(row)} | {ticks} | {off} | {row.reads} |"


def _limit(row: Row) -> str:
    if row.ticks is None or not row.limit_ms or isinstance(row.fault, ProgramFault):
        return ""
    if row.limit is None:
        return f"{row.limit_ms} ms"
    return f"{row.limit_ms} ms, `{row.limit}`" if row.limit in Limits.model_fields else row.limit


def _arm(row: Row) -> str:
    if row.fault is ProgramFault.KILLED:
        return "is let go" if row.off_ms else "holds still"
    return "goes on" if row.ticks is None else "stops"
