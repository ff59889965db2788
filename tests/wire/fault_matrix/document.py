"""The fault matrix as a page of the docs."""

from collections.abc import Sequence

from palpate.robot_io.guard import Limits
from tests.wire.fault_matrix.rows import FAMILIES, ProgramFault, Row
from tests.wire.parts import ROOT

DOCUMENT = ROOT / "docs" / "reference" / "fault-matrix.md"
_HEAD = """\
# Fault matrix: reaction of the arm to each fault

`docs/make_fault_matrix.py` writes this page from `tests/wire/fault_matrix/rows.py`. The tests inject each
fault below into the real drivers, on emulated devices in simulated time, during a probing run at 1 kHz (250
Hz with the Feetech arm).

- **arm**: *stops* means that the guard commands its safe state. It brakes the joints for 300 ms and then
  switches their torque off; if positions are unknown, it switches the torque off at once. `palpate probe`
  also compensates the arm's weight and lowers the arm. *continues* means that the fault does no harm.
- **limit**: how long the fault may last, from the section `limits` of the robot file. Usually this is the
  age limit of the device's samples. If a check compares samples, the table names its own limit. The cell is
  empty if a device or the program reports the fault at once.
- **ticks**: largest number of ticks from the fault to the safe state. This is the limit plus two ticks,
  unless a number in brackets refers to a reason below.
- **off**: longest time from the fault until no drive exerts torque.
- **message**: part of the line that the user sees and that the session records as an event. In every row,
  the session can be read at least up to the fault.

The load of the test machine does not affect these figures, because time is simulated.
"""
_REASONS = """
## Reasons for more than the limit plus two ticks

"""
_TAIL = """
## Not in the table

- An arm with two Feetech servos on its shoulder continues if one of them exerts no torque. These servos
  report a duty cycle instead of a torque, and the other servo carries the joint.
- A serial force sensor has no id and no alert, so neither can be wrong.
- A force sensor that freezes while the arm is at rest, or whose steps are as coarse as its noise, cannot be
  distinguished from a working sensor. `stuck_force_s` counts only after the arm has moved. The joint torques
  contradict such a sensor later, once the force is a few newtons.
- No viewer is connected to the loop; recordings for viewers are made from the session afterwards. *viewer
  gone* stands for a failure of the online estimator, which observes the arm while it moves.
- Time stamps come from the machine's monotonic clock, which nobody can set. If this clock went back, the loop
  would wait until the clock has caught up. CAN motors would get no requests during this time, and the arm
  would stop because their samples are too old. A jump forward counts as *program held up*.
- If the program is killed, its session is complete up to the last tick, because another process writes it.
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
    lines = [title, "| fault | arm | limit | ticks | off | message |", "|---|---|---|---|---|---|"]
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
        return "torque off" if row.off_ms else "holds still"
    return "continues" if row.ticks is None else "stops"
