"""Leader and follower as processes, and each when the other is killed."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest
import yaml

from palpate.robot_io.errors import PalpateError
from palpate.robot_io.session import Session
from palpate.teleop import demo
from palpate.teleop.demo import script
from palpate.teleop.merged_sessions import merge_sessions
from tests.free_port import free_port
from tests.palpate.cli import assert_refused, done, run
from tests.palpate.teleop.sides import (
    WAIT_S,
    ScriptedPeer,
    follow_until_asked,
    killed_when_reached,
    lead_until_hold,
)
from tests.robot_io.link.link_parts import intent

pytestmark = pytest.mark.slow


@contextmanager
def started(side: str, *options: str) -> Iterator[subprocess.Popen]:
    command = [sys.executable, "-m", "palpate.main", "teleop", side, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def states(session: Session) -> list[str]:
    """What became of the targets so far."""
    return [
        event.data["state"] for event in session.events if event.kind == "target" and "state" in event.data
    ]


@pytest.mark.parametrize(("on_silence", "ending"), [("finish", "DONE"), ("retreat", "CANCELLED")])
def test_killed_leader_leaves_the_arm_safe_and_a_new_leader_connects(tmp_path, on_silence, ending):
    port, session = free_port(), tmp_path / "follower.mcap"
    options = ("--port", str(port), "-o", str(session), "--no-diagnose", "--on-silence", on_silence)
    with started("follower", *options) as process:
        assert killed_when_reached(lead_until_hold, port).exitcode == -signal.SIGKILL
        end_s = time.monotonic() + WAIT_S
        while not states(Session.open(session)):  # before that, another leader would call the target off
            assert time.monotonic() < end_s
            time.sleep(0.5)
        assert process.poll() is None
        second = ScriptedPeer("leader", port)
        second.until(lambda _: intent(ended=True), lambda side: getattr(side.last, "ended", False))
        output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0, output
    assert "without --key, any program on this machine can command the arm" in output
    kept = Session.open(session)
    assert states(kept)[0] == ending
    assert "link_silent" in [event.kind for event in kept.events]
    ticks = kept.samples("tick")
    assert not ticks["guard_tripped"].any()
    silent_s = next(event.time_s for event in kept.events if event.kind == "link_silent")
    after = ticks["time_s"] > silent_s
    probed = np.unique(ticks["run"][after])
    assert set(probed) <= {-1, 0, 1, 2}  # the second target was never begun
    assert np.abs(ticks["joint_position_rad"][-1] - ticks["joint_position_rad"][0]).max() < 0.01


def test_killed_follower_leaves_the_virtual_object_and_a_message(tmp_path):
    port, session, plan = free_port(), tmp_path / "leader.mcap", tmp_path / "operator.yaml"
    plan.write_text(yaml.safe_dump(script(0.05)))
    with started("leader", "--port", str(port), "-o", str(session), "--operator", str(plan)) as process:
        assert killed_when_reached(follow_until_asked, port).exitcode == -signal.SIGKILL
        output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 1, output
    assert "the follower is silent" in output
    assert "palpate: the follower did not finish target 0, target 1: it ended, fell silent" in output
    haptic = Session.open(session).samples("haptic")
    assert haptic["force_n"].max() > 1.0  # felt without a follower, too
    assert haptic["time_s"][-1] - haptic["time_s"][0] > 15.0


def test_unavailable_device_is_one_line_and_leaves_no_session(tmp_path):
    operator, session = tmp_path / "operator.yaml", tmp_path / "leader.mcap"
    operator.write_text(f"device: gamepad\nport: {tmp_path / 'nothing'}\n")
    with started(
        "leader", "--port", str(free_port()), "-o", str(session), "--operator", str(operator)
    ) as process:
        output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 2
    (said,) = [line for line in output.splitlines() if line.startswith("palpate:")]
    assert "the operator's device cannot be opened" in said
    assert "nothing: cannot be opened (No such file" in said
    assert not session.exists()


def test_killed_main_process_ends_the_haptic_one_with_its_session_closed(tmp_path):
    session, plan = tmp_path / "leader.mcap", tmp_path / "operator.yaml"
    plan.write_text(yaml.safe_dump(script(0.05)))
    with started(
        "leader", "--port", str(free_port()), "-o", str(session), "--operator", str(plan)
    ) as process:
        end_s = time.monotonic() + WAIT_S
        while not session.exists():
            assert time.monotonic() < end_s
            time.sleep(0.1)
        time.sleep(2.0)
        process.send_signal(signal.SIGKILL)
        process.wait()
    while Session.open(session).unclosed or "haptic" not in Session.open(session).stream_names:
        assert time.monotonic() < end_s, "the haptic process goes on without its main process"
        time.sleep(0.2)
    assert len(Session.open(session).samples("haptic")) > 500


def test_merged_sessions_share_one_clock_and_rendered_force_equals_real_force(tmp_path):
    """Merged, the two sessions say when what happened, and how far apart the forces are."""
    port, plan = str(free_port()), tmp_path / "operator.yaml"
    plan.write_text(yaml.safe_dump(script(0.05)))
    sessions = {side: tmp_path / f"{side}.mcap" for side in ("leader", "follower")}
    common = {side: ("--port", port, "-o", str(path)) for side, path in sessions.items()}
    with (
        started("follower", *common["follower"], "--no-diagnose") as follower,
        started("leader", *common["leader"], "--operator", str(plan), "--scenario", "soft") as leader,
    ):
        said = [process.communicate(timeout=2 * WAIT_S)[0] for process in (leader, follower)]
    assert (leader.returncode, follower.returncode) == (0, 0), said
    assert all("target 0: done, target 1: done; " in printed for printed in said)
    assert f"palpate inspect {sessions['leader']} FOLLOWER.mcap" in said[0]
    merged = merge_sessions(*(Session.open(path) for path in sessions.values()))
    assert merged.compare_modeled_to_measured().share < 0.05
    assert merged.round_trip_s < 0.05

    def first(session: Session, kind: str) -> float:
        return next(event.time_s for event in session.events if event.kind == kind)

    chosen, felt = (first(merged.leader, kind) for kind in ("target", "feel"))
    begun, made = merged.to_leader(
        np.array([first(merged.follower, kind) for kind in ("target", "estimate")])
    )
    slack_s = 2.0  # what a simulated clock may slip on a busy machine while an offset is held for the best
    assert chosen < begun + slack_s < made + slack_s < felt + 2 * slack_s  # the order, across both clocks
    result = done("inspect", sessions["follower"], sessions["leader"], "--save", tmp_path / "both.rrd")
    assert "the follower's times are shown on the leader's clock; the clocks' offset" in result.stdout
    assert_refused(run("inspect", sessions["leader"]), "give its follower's session as well")
    assert_refused(run("inspect", sessions["leader"], sessions["leader"]), "a leader and of its follower")


def test_demo_ends_slow_sides_also_as_a_background_job_of_a_script(tmp_path, monkeypatch):
    (tmp_path / "operator.yaml").write_text(yaml.safe_dump(script(0.05)))
    port = str(free_port())
    commands = {side: ["--port", port, "-o", str(tmp_path / f"{side}.mcap")] for side in demo._SIDES}
    commands["leader"] += ["--operator", str(tmp_path / "operator.yaml")]
    monkeypatch.setattr(demo, "_START_S", 0.0)
    with pytest.raises(
        PalpateError, match=r"too slow: both sides did not start within 0 s\. End other programs"
    ):
        demo._run_both(tmp_path, commands)
    monkeypatch.setattr(demo, "_START_S", WAIT_S)
    monkeypatch.setattr(demo, "_LIMIT_S", 3.0)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts a background job
    try:
        with suppress(PalpateError):  # the sides may not have met yet
            assert demo._run_both(tmp_path, commands)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    ended = (tmp_path / "follower.log").read_text()
    assert "interrupted" in ended
    assert "SIGTERM" not in ended
