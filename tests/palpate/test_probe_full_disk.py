"""`palpate probe` when nothing is kept any longer: the simulated arm comes to its end, the user is told."""

import resource
import sys

import pytest

from palpate.robot_io.session import Session, SessionWriter
from palpate.runs import session as run_session
from tests.palpate.cli import run

ROOM_BYTES = 300_000  # to the writer process a file that may not grow is a disk that is full


class SmallDisk(SessionWriter):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, (ROOM_BYTES, ROOM_BYTES))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits another process as Linux does")
def test_a_full_disk_stops_no_arm_and_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(run_session, "SessionWriter", SmallDisk)
    path = tmp_path / "s.mcap"
    said = run("probe", "-o", path, "--speed-mm-s", 150, "--hold-s", 0.2, "--online", "none")

    assert said.exit_code == 3
    assert said.stderr.strip().endswith("s.mcap is not complete: File too large")
    session = Session.open(path)
    assert session.truncated
    ticks = session.samples("tick")
    assert len(ticks) > 300
    assert (ticks["phase"] > 0).any()


class DeadWriter(SessionWriter):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self._process.kill()
        self._process.wait()


def test_a_writer_that_was_killed_is_no_bad_input(tmp_path, monkeypatch):
    monkeypatch.setattr(run_session, "SessionWriter", DeadWriter)
    path = tmp_path / "s.mcap"
    said = run("probe", "-o", path, "--speed-mm-s", 150, "--hold-s", 0.2, "--online", "none")
    assert said.exit_code == 1
    assert said.stderr.strip().endswith("s.mcap is not complete: the writer process ended with -9")
