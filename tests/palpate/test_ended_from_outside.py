"""Programs and processes ended from outside: what remains, and Ctrl-C in workers."""

import signal
import subprocess
import sys
from multiprocessing.context import SpawnProcess
from types import SimpleNamespace

import pytest

from palpate.common.worker_process import start_worker
from palpate.robot_io.errors import SessionError
from palpate.robot_io.session import SessionWriter
from palpate.runs.session import ArmSession
from tests.palpate.cli import ROOT
from tests.palpate.presses import write_presses
from tests.palpate.worker_tasks import do_nothing, send_blocked
from tests.robot_io.session_parts import METADATA, TICK

HALF_WRITTEN = """
import sys, time
from pathlib import Path
from palpate import main
from palpate.robot_io.files.atomic_write import atomic_write
def run():
    with atomic_write(Path(sys.argv[1])) as unfinished:
        unfinished.write_text("half of it")
        print("begun", flush=True)
        for _ in range(600):  # a signal just before a sleep begins does not end this sleep
            time.sleep(0.1)
main.run = run
main.main()
"""


DIAGNOSING = """
import os, sys, time
import numpy as np
from palpate import Study, main
from palpate.estimation.diagnosis import diagnose
module = sys.modules["palpate.estimation.diagnosis.diagnose"]
def judge(*_):
    os.write(1, b"begun\\n")
    time.sleep(60)
module.diagnose_channel = judge
def run():
    t = np.arange(0.0, 1.0, 0.01)
    joint = {"position_{}_rad": np.sin(t), "torque_{}_Nm": np.cos(t)}
    both = {name.format(number): values for number in (1, 2) for name, values in joint.items()}
    channels = Study({"time_s": t, **both}).channels
    rng = np.random.default_rng(0)
    diagnose([one.data for one in channels], [one.model for one in channels], rng=rng, processes=2)
main.run = run
main.main()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_ended_diagnosis_ends_its_workers_at_once(number):
    with subprocess.Popen([sys.executable, "-c", DIAGNOSING], stdout=subprocess.PIPE, cwd=ROOT) as program:
        assert [program.stdout.readline() for _ in range(2)] == [b"begun\n"] * 2
        program.send_signal(number)
        assert program.wait(30) == (-number if number == signal.SIGKILL else 128 + number)
        assert program.stdout.read() == b""  # comes to its end once no worker holds it open


FITTING_AHEAD = """
import asyncio, sys, time
from palpate.study import Study
from palpate.workbench.processes import FitPrefetcher
study = Study(sys.argv[1], keep=False)
ahead = FitPrefetcher(study, study.channels[0])
asyncio.run(ahead.fit(("cubic_stiffness",)))
print("begun", flush=True)
time.sleep(60)
"""


def test_killed_workbench_leaves_no_process_behind(tmp_path):
    command = [sys.executable, "-c", FITTING_AHEAD, str(write_presses(tmp_path / "press.csv"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as program:
        assert program.stdout.readline() == b"begun\n"
        program.kill()
        assert program.stdout.read() == b""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_ended_program_leaves_no_partial_file(number, tmp_path):
    command = [sys.executable, "-c", HALF_WRITTEN, str(tmp_path / "x")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as program:
        program.stdout.readline()
        assert len(list(tmp_path.iterdir())) == 1
        program.send_signal(number)
        assert program.wait(30) == 128 + number
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("world", "ends"), [(None, True), (SimpleNamespace, False)])
def test_only_a_real_arm_stops_when_its_log_writer_dies(world, ends, tmp_path):
    log = SessionWriter(tmp_path / "s.mcap", [TICK], METADATA)
    arm = ArmSession(None, None, None, None, log, None, world)
    assert not arm.unlogged()
    log._process.kill()
    log._process.wait()
    assert arm.unlogged() == ("writing the session failed (the writer process ended with -9)" * ends)
    with pytest.raises(SessionError, match="writer process ended with -9"):
        log.close()


def test_ctrl_c_is_blocked_in_a_worker_and_not_here():
    process, pipe = start_worker(send_blocked)
    assert pipe.recv()
    process.join()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_ctrl_c_while_a_worker_starts_is_handled_afterwards(monkeypatch):
    start, started = SpawnProcess.start, []

    def interrupted(process):
        signal.raise_signal(signal.SIGINT)
        start(process)
        started.append(process)

    monkeypatch.setattr(SpawnProcess, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        start_worker(do_nothing)
    started[0].join()
    assert started[0].exitcode == 0
