"""A run is read back from a real session as it was, and the loop never waits for the writer."""

import numpy as np

from control.loop import run_loop
from control.phases import Phase
from control.tick_record import STREAM_NAME, tick_stream
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
            observer=lambda record: (2.0 * record["time_s"], 1.0, 0.5),
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
