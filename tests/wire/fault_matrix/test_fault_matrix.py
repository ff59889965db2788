"""Every fault of the matrix happens: what the arm does, how soon, what is read, what the session holds."""

import sys
from contextlib import suppress

import pytest

from robot_io.errors import DeviceError
from tests.wire.fault_matrix.document import DOCUMENT, document
from tests.wire.fault_matrix.rig import TICK_S, Rig
from tests.wire.fault_matrix.rows import Program, Row, rows

ROWS = tuple(rows())


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.label)
def test_a_fault_ends_as_the_matrix_says(row: Row, tmp_path):
    if row.fault is Program.DISK_FULL and not sys.platform.startswith("linux"):
        pytest.skip("fills the disk of another process as Linux lets it")
    rig = Rig(row, tmp_path)
    try:
        seen = rig.run()
    finally:
        with suppress(DeviceError):
            rig.bench.robot.close()
        rig.bench.arm.bench.close()
    assert row.reads in seen.reads
    assert seen.trips == (row.ticks is not None), seen.reads
    if row.ticks is not None:
        assert 0 <= seen.ticks <= row.ticks
        assert any(row.reads in text for text in seen.session_events)
    if row.off_ms is not None:
        assert seen.torque_off_ms <= row.off_ms
    if row.fault is not Program.DISK_FULL:
        assert seen.last_tick_s >= row.at_s - TICK_S


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.label)
def test_what_takes_longer_than_the_age_limit_and_two_ticks_has_a_reason(row: Row):
    slow = row.ticks is not None and row.ticks > row.prompt_ticks
    deaf = row.ticks is None and row.off_ms is not None
    assert row.because or not (slow or deaf)


def test_no_row_is_there_twice():
    assert len({row.label for row in ROWS}) == len(ROWS)


def test_the_document_is_up_to_date():
    """Otherwise run `.venv/bin/python docs/make_fault_matrix.py`."""
    assert DOCUMENT.read_text(encoding="utf-8") == document(ROWS)
