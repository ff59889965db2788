"""Outcome of every fault in the matrix: motion, time, message and session."""

import sys
from contextlib import suppress

import pytest

from palpate.robot_io.errors import DeviceError
from tests.wire.fault_matrix.document import DOCUMENT, document
from tests.wire.fault_matrix.rig import FaultRig
from tests.wire.fault_matrix.rows import HOLDS, ProgramFault, Row, rows

ROWS = tuple(rows())
SOON = {  # each way in which a driver of each kind can be told; `make test-all` runs every row
    *("dynamixel, alert", "dynamixel, reply corrupt", "dynamixel, program killed"),
    *("odrive, reply lost", "odrive, reply corrupt", "odrive, reboot, back at once", "odrive, unplugged"),
    *("mit, reply lost", "mit, alert", "mit, reply duplicated", "mit, controller exception"),
    *("odrive, program killed", "mit, program killed", "loadstar, not a number", "loadstar, reboot"),
    *(
        "damiao, program killed",
        "damiao, reboot, back at once",
        "robstride, program killed",
        "robstride, alert",
        "robstride, reboot, back at once",
        "moteus, program killed",
        "moteus, reboot, back at once",
        "feetech, reboot, back at once",
        "feetech, program killed",
        "cell, not a number",
        "net_ft, not a number",
        "bota, saturated",
    ),
    *("dynamixel_pair, second servo's horn slips", "feetech_pair, second servo overloaded"),
    *("lorenz, unplugged", "lorenz, saturated", "lines, saturated"),
}

PHASES_MS = (0, 5, 10, 15)  # of a tick of 4 ms, and of a goal that moves by a count in 20 ms
PHASED = {"feetech_pair, second servo silent", "feetech_pair, second servo ignores goals"}


def test_quick_fault_cases_are_in_the_matrix():
    assert {row.label for row in ROWS} >= SOON | PHASED


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(
            row.later(1e-3 * phase_ms),
            id=f"{row.label}, {phase_ms} ms later" if phase_ms else row.label,
            marks=() if row.label in SOON else pytest.mark.slow,
        )
        for row in ROWS
        for phase_ms in (PHASES_MS if row.label in PHASED else (0,))
    ],
)
def test_fault_has_the_outcome_in_the_fault_matrix(row: Row, tmp_path):
    if row.fault is ProgramFault.DISK_FULL and not sys.platform.startswith("linux"):
        pytest.skip("fills the disk of another process as Linux lets it")
    rig = FaultRig(row, tmp_path)
    try:
        seen = rig.run()
    finally:
        with suppress(DeviceError):
            rig.setup.robot.close()
        rig.setup.arm.emulator.close()
    assert row.reads in seen.reads
    assert seen.trips == (row.ticks is not None), seen.reads
    if row.ticks is not None:
        assert 0 <= seen.ticks <= row.ticks
        assert any(row.reads in text for text in seen.session_events)
    if row.off_ms is not None:
        assert seen.torque_off_ms <= row.off_ms
    if row.because == HOLDS:
        assert seen.fastest_rad_s < 0.05
    if row.fault is not ProgramFault.DISK_FULL:
        assert seen.last_tick_s >= row.at_s - 2 * rig.tick_s  # nor the tick of the fault


def test_slow_rows_have_a_reason_and_the_document_is_up_to_date():
    slow = [row.label for row in ROWS if row.ticks is not None and row.ticks > row.prompt_ticks]
    deaf = [row.label for row in ROWS if row.ticks is None and row.off_ms is not None]
    assert {*slow, *deaf} <= {row.label for row in ROWS if row.because}
    assert len({row.label for row in ROWS}) == len(ROWS)
    # Otherwise run `.venv/bin/python docs/make_fault_matrix.py`.
    assert DOCUMENT.read_text(encoding="utf-8") == document(ROWS)
