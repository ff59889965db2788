"""A run is read back from a real session as it was, and the loop never waits for the writer."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.loop.tick_record import STREAM_NAME, tick_stream
from robot_io.session import Session, SessionMetadata, SessionWriter
from tests.control.loop_parts import JOINTS, RATE_HZ, Arm, Swing


def test_a_run_is_read_back_with_units_and_events(tmp_path):
    arm, path = Arm(), tmp_path / "run.mcap"
    with SessionWriter(path, [tick_stream(JOINTS)], SessionMetadata(), wait_for_room=True) as log:
        result = run_loop(
            arm.robot,
            arm.guard,
            Swing(fail_at=400),
            arm.clock,
            log,
            rate_hz=RATE_HZ,
            observer=lambda measurement, output: (2.0 * measurement.time_s, 1.0, 0.5),
        )
    session = Session.open(path)
    ticks = session.samples(STREAM_NAME)
    assert len(ticks) == result.ticks > 400
    assert np.array_equal(ticks["torque_sent_nm"], arm.sent_nm)
    assert np.array_equal(ticks["phase"], np.where(ticks["guard_tripped"], Phase.STOPPED, Phase.LOADING))
    running = ~ticks["guard_tripped"]
    assert np.array_equal(ticks["stiffness_n_m"][running], 2.0 * ticks["time_s"][running])
    assert np.isnan(ticks["stiffness_n_m"][~running]).all()
    assert ticks.units["tip_velocity_world_m_s"] == "m/s"
    assert {"touch", "trip", "loop_ended"} <= {event.kind for event in session.events}
    assert session.dropped == 0


PROGRAM = """
import sys
from control.loop.loop import run_loop
from control.loop.tick_record import tick_stream
from robot_io.clock import MonotonicClock
from robot_io.session import SessionMetadata, SessionWriter
from tests.control.loop_parts import JOINTS, RATE_HZ, Arm, Swing

class Announced(Swing):
    def step(self, measurement, dt_s):
        if self.steps == 20:
            print("running", flush=True)
        return super().step(measurement, dt_s)

if __name__ == "__main__":
    arm = Arm(MonotonicClock(), age_limit_s=10.0)
    with SessionWriter(sys.argv[1], [tick_stream(JOINTS)], SessionMetadata()) as log:
        result = run_loop(arm.robot, arm.guard, Announced(torque_nm=0.01), arm.clock, log, rate_hz=RATE_HZ)
    print(result.outcome, arm.bus.powered)
"""


def test_ctrl_c_in_a_terminal_ends_the_arm_safely_and_leaves_a_whole_session(tmp_path):
    """A terminal sends SIGINT to every process of the program, so to the log's writer as well; and twice."""
    path = tmp_path / "run.mcap"
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    program = subprocess.Popen(
        [sys.executable, str(tmp_path / "program.py"), str(path)],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert program.stdout.readline() == "running\n"
    os.killpg(program.pid, signal.SIGINT)
    os.killpg(program.pid, signal.SIGINT)
    output, _ = program.communicate()
    assert output == "stopped False\n"
    assert program.returncode == 0
    session = Session.open(path)
    assert not session.truncated
    assert (session.samples(STREAM_NAME)["torque_sent_nm"][-1] == 0).all()
    assert any("interrupted by the user (SIGINT)" in event.text for event in session.events)
