"""Every fault of the matrix happens: what the arm does, how soon, what is read, what the session holds."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest

from robot_io.errors import DeviceError
from robot_io.session import Session
from tests.wire.fault_matrix.document import DOCUMENT, document
from tests.wire.fault_matrix.rig import NO_TORQUE_NM, SESSION, TICK_S, Rig
from tests.wire.fault_matrix.rows import MOVING_S, Program, Row, rows
from tests.wire.parts import ROOT

pytestmark = pytest.mark.slow

ROWS = tuple(rows())
WATCHDOG_MS = 102.0  # the slowest, as in the rows of a program that is killed


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


@pytest.mark.parametrize("family", ["dynamixel", "odrive", "mit"])
def test_while_the_program_is_held_up_the_watchdogs_let_go(family, tmp_path):
    row = next(row for row in ROWS if row.family == family and row.fault is Program.HELD_UP)
    rig = Rig(row, tmp_path)
    driven_ms = []

    def watch(time_s):
        if time_s > row.at_s and np.abs(rig.bench.drive_torque_nm).max() > NO_TORQUE_NM:
            driven_ms.append(1e3 * (time_s - row.at_s))

    rig.clock.subscribe(watch)
    try:
        rig.run()
    finally:
        with suppress(DeviceError):
            rig.bench.robot.close()
        rig.bench.arm.bench.close()
    assert not [at_ms for at_ms in driven_ms if at_ms > WATCHDOG_MS]  # nor by the command that was held up


PROGRAM = """
import sys
from pathlib import Path
from tests.wire.fault_matrix.rig import Rig
from tests.wire.fault_matrix.rows import Program, rows

killed = next(row for row in rows() if row.fault is Program.KILLED)
Rig(killed, Path(sys.argv[1]), really=True).run()
"""


def test_a_program_that_is_killed_leaves_its_session_up_to_there(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    died = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert died.returncode == -signal.SIGKILL, died.stderr
    give_up_s = time.monotonic() + 30.0  # for the writer process to finish the file
    while Session.open(tmp_path / SESSION).truncated and time.monotonic() < give_up_s:
        time.sleep(0.02)
    session = Session.open(tmp_path / SESSION)
    assert not session.truncated
    last_s = session.samples("tick")["time_s"][-1]
    assert MOVING_S - 2 * TICK_S <= last_s <= MOVING_S + TICK_S


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.label)
def test_what_takes_longer_than_its_limit_and_two_ticks_has_a_reason(row: Row):
    slow = row.ticks is not None and row.ticks > row.prompt_ticks
    deaf = row.ticks is None and row.off_ms is not None
    assert row.because or not (slow or deaf)


def test_no_row_is_there_twice():
    assert len({row.label for row in ROWS}) == len(ROWS)


def test_the_document_is_up_to_date():
    """Otherwise run `.venv/bin/python docs/make_fault_matrix.py`."""
    assert DOCUMENT.read_text(encoding="utf-8") == document(ROWS)
