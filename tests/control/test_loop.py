"""Control loop on simulated time: ends, records, and commands that are sent."""

import time
from itertools import count

import numpy as np
import pytest

import palpate.control.loop.loop
from palpate.control.arm.rigid_body import TipMotion
from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import LoopResult, Outcome
from palpate.control.loop.task import Phase, TaskOutput, checked_output, make_output
from palpate.control.loop.tick_record import STREAM_NAME, tick_stream
from palpate.control.loop.timing import SECTIONS
from palpate.control.paths.trajectory import JointMotion
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.errors import DeviceTimeoutError, InputError, SafetyTripError
from palpate.robot_io.robot import RobotState
from palpate.robot_io.session import Session, SessionMetadata, SessionWriter
from palpate.robot_io.types import Command
from tests.control.loop_parts import JOINTS, RATE_HZ, MemoryLog, MockArm, SwingTask


def run(arm, task, log=None, **options):
    log = MemoryLog() if log is None else log
    return run_loop(arm.robot, arm.guard, task, arm.clock, log, rate_hz=RATE_HZ, **options), log


def test_finished_task_is_recorded_tick_by_tick_and_ends_with_the_torque_off():
    arm, task = MockArm(), SwingTask(done_at=50, torque_nm=0.1)
    result, log = run(arm, task)
    assert result.outcome is Outcome.FINISHED
    assert (result.cause, result.ticks, result.overruns) == ("", 50, 0)
    assert arm.robot.state is RobotState.CONFIGURED
    assert not arm.bus.powered
    assert len(log.records) == 50
    assert task.started_from is not None
    assert task.dts_s == pytest.approx([1.0 / RATE_HZ] * 50)
    result.raise_for_trip()  # nothing to raise
    assert np.allclose(log.column("torque_commanded_nm"), 0.1)
    assert np.array_equal(log.column("torque_sent_nm"), arm.sent_nm)
    assert np.array_equal(log.column("phase"), [Phase.LOADING] * 50)
    assert np.array_equal(log.column("run"), [4] * 50)
    assert np.array_equal(log.column("tick"), range(50))
    assert np.allclose(np.diff(log.column("time_s")), 1e-3)
    assert np.isnan(log.column("stiffness_n_m")).all()
    assert np.array_equal(log.column("torque_measured_nm")[1:], arm.sent_nm[:-1])  # the plant obeyed
    touches = [(time_s, text) for time_s, kind, text in log.events if kind == "touch"]
    assert touches == [(log.column("time_s")[2], "touched")]


def test_task_reference_is_recorded_in_its_columns():
    motion = JointMotion(np.ones(3), np.full(3, 2.0), np.full(3, 3.0))
    tip = TipMotion(np.full(3, 4.0), np.eye(3), np.full(3, 5.0), np.zeros((6, 3)))
    down = np.array([0.0, 0.0, -1.0])
    aimed = make_output(Command(np.zeros(3)), motion, tip, down, Phase.APPROACH)
    assert [aimed[i][0] for i in range(1, 5)] == [1.0, 2.0, 4.0, 5.0]
    assert aimed.press_direction_world is down
    assert np.isnan(aimed.desired_force_n)
    assert (aimed.phase, aimed.run, aimed.done, aimed.events) == (Phase.APPROACH, -1, False, ())
    assert checked_output(aimed, (3,)) is aimed
    plain = TaskOutput(*aimed[:8])
    assert (plain.run, plain.done) == (-1, False)


class _LateClock(SimulatedClock):
    """Wakes the loop up late, each time by another amount."""

    def __init__(self):
        super().__init__()
        self.lateness_s = []

    def sleep_until(self, time_s):
        self.lateness_s.append(1e-4 * (len(self.lateness_s) % 7))
        super().sleep_until(time_s + self.lateness_s[-1])


def test_lateness_counts_from_the_due_time_and_does_not_shift_the_next_tick():
    result, log = run(MockArm(clock := _LateClock()), SwingTask(done_at=30, torque_nm=0.0))
    assert log.column("lateness_s") == pytest.approx(clock.lateness_s, abs=1e-9)
    assert log.column("time_s") - log.column("lateness_s") == pytest.approx(1e-3 * np.arange(1, 31))
    assert result.timing["lateness"].max_s == pytest.approx(6e-4)
    assert result.overruns == 0


def test_stop_request_triggers_a_safe_stop():
    arm, task = MockArm(), SwingTask()
    result, log = run(arm, task, stop=lambda: "enough is known" * (task.steps >= 40))
    assert result.outcome is Outcome.STOPPED
    assert result.cause == "stopped: enough is known"
    assert log.texts("stop") == ["stopped: enough is known"]
    assert log.texts("trip") == []
    assert log.column("phase")[-1] == Phase.STOPPED
    assert np.abs(arm.sent_nm[-1]).max() == 0.0
    assert not arm.bus.powered
    result.raise_for_trip()  # asked for: not an error


def test_observer_sees_each_tick_and_its_estimates_are_logged():
    seen = []

    def observe(measurement, output):
        seen.append((output.run, measurement.force_n))
        return 500.0 + len(seen), 10.0, 0.25

    arm = MockArm()
    arm.plant.hand_force_n = 3.0
    _, log = run(arm, SwingTask(done_at=20), observer=observe)
    assert min(force_n for _, force_n in seen) > 2.0
    assert seen == list(zip(log.column("run"), log.column("force_n"), strict=True))
    assert np.array_equal(log.column("stiffness_n_m"), 501.0 + np.arange(20))
    assert np.array_equal(log.column("surface_m"), [0.25] * 20)
    assert (log.column("observer_s") > 0).all()


def test_sections_of_a_tick_add_up_to_the_tick(monkeypatch):
    looks = count(step=1e-5)  # a stopwatch on which 10 us pass between two looks, whatever the machine does
    monkeypatch.setattr(palpate.control.loop.loop, "perf_counter", lambda: next(looks))
    result, log = run(MockArm(), SwingTask(done_at=200, torque_nm=0.0), observer=lambda *_: (1.0, 2.0, 3.0))
    assert list(result.timing) == list(SECTIONS)
    assert all(section.count == 200 for section in result.timing.values())
    parts = [result.timing[name].max_s for name in SECTIONS if name not in {"tick", "lateness"}]
    assert parts == pytest.approx([1e-5, 1e-5, 2e-5, 1e-5, 1e-5, 1e-5])  # the guard is asked twice
    assert sum(parts) == pytest.approx(result.timing["tick"].max_s)
    assert log.column("control_s") == pytest.approx(result.timing["control"].max_s)
    assert log.column("log_s")[0] == 0.0 < log.column("log_s")[1:].min()  # it is the tick before's
    assert result.timing["lateness"].max_s == 0.0  # simulated time is never late
    assert result.duration_s == pytest.approx(0.2, abs=1e-6)


def test_reading_leaves_time_for_the_command_and_the_next_tick():
    arm, left_s = MockArm(), {"read": [], "write": []}

    def timed(name, call):
        def hooked(deadline_s):
            left_s[name].append(deadline_s - arm.clock.now_s())
            call(deadline_s)

        return hooked

    arm.bus.poll, arm.bus.flush = timed("read", arm.bus.poll), timed("write", arm.bus.flush)
    run(arm, SwingTask(done_at=20))
    assert 0.5 / RATE_HZ <= min(left_s["read"][1:]) <= max(left_s["read"][1:]) <= 0.75 / RATE_HZ
    assert left_s["read"][0] == pytest.approx(1.0 / RATE_HZ)  # nothing is commanded before the first tick
    assert left_s["write"][:20] == pytest.approx([1.0 / RATE_HZ] * 20)


def test_overrun_is_counted_skipped_and_passed_to_the_task():
    arm, task = MockArm(), SwingTask(done_at=20)

    def stall():
        if task.steps == 10:
            arm.clock.sleep_until(arm.clock.now_s() + 0.0035)

    arm.on_poll = stall
    result, log = run(arm, task)
    assert (result.overruns, result.skipped) == (1, 3)
    assert result.ticks == 20
    assert sorted(set(np.diff(log.column("tick")))) == [1, 4]
    assert max(task.dts_s) == pytest.approx(4e-3)
    on_grid = log.column("time_s") * RATE_HZ
    assert np.allclose(on_grid, np.round(on_grid), atol=1e-6)


def test_loop_waits_for_the_first_samples_with_the_torque_off():
    arm = MockArm()
    arm.faults.silent.add("force")

    def sample_later():
        assert not arm.bus.powered
        if arm.clock.now_s() > 0.0045:
            arm.faults.silent.clear()
            arm.on_poll = lambda: None

    arm.on_poll = sample_later
    result, _ = run(arm, SwingTask(done_at=5))
    assert result.outcome is Outcome.FINISHED


def test_sensor_without_samples_is_named_and_power_stays_off():
    arm = MockArm()
    arm.faults.silent.add("force")
    with pytest.raises(
        DeviceTimeoutError, match="not all devices sent a sample within 1 s: force sensor: no sample yet"
    ):
        run_loop(arm.robot, arm.guard, SwingTask(), arm.clock, MemoryLog(), rate_hz=4.0)
    assert arm.clock.now_s() == 1.0
    assert arm.sent_nm == []


def test_arm_outside_its_limits_is_not_powered():
    arm = MockArm()
    arm.plant.angle_rad = np.cumsum([-1.0, 2.7, 1.0])
    result, log = run(arm, SwingTask())
    assert result.outcome is Outcome.TRIPPED
    assert "joint 2" in result.cause
    assert (result.ticks, arm.sent_nm) == (0, [])
    assert log.texts("trip") == [result.cause]
    with pytest.raises(SafetyTripError, match="joint 2"):
        result.raise_for_trip()


def test_tripped_guard_is_refused_until_rearmed():
    arm = MockArm()
    arm.guard.trip("the cable was loose")
    with pytest.raises(SafetyTripError, match="the cable was loose"):
        run(arm, SwingTask())


def test_same_arm_and_guard_run_again():
    arm = MockArm()
    for _ in range(2):
        begun_s = time.perf_counter()
        result, log = run(arm, SwingTask(done_at=30, torque_nm=0.01))
        assert result.outcome is Outcome.FINISHED
        assert len(log.records) == 30
        assert result.duration_s == pytest.approx(0.03, abs=1.5e-3)
        assert 0.0 < result.wall_s < time.perf_counter() - begun_s


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ({"overruns": 1}, ", 1 overruns"),
        ({"dropped": 2}, ", 2 records dropped"),
        ({"unsent": 3}, ", 3 commands not sent"),
        ({"log_error": "disk full"}, "; the log is not complete: disk full"),
        ({"observer_error": "singular"}, "; online estimation was switched off: singular"),
        ({"deactivation_error": "silent"}, "; the torque may still be on: silent"),
    ],
    ids=str,
)
def test_result_line_states_each_problem(trouble, words):
    good = LoopResult(Outcome.STOPPED, "on request", ticks=5)
    assert (good.is_clean, good.one_line()) == (True, "stopped: on request; 5 ticks")
    assert (good.skipped, good.log_failures, good.duration_s, good.wall_s) == (0, 0, 0.0, 0.0)
    bad = LoopResult(Outcome.FINISHED, ticks=5, **trouble)
    assert (bad.is_clean, bad.one_line()) == (False, f"finished; 5 ticks{words}")


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_rate_is_refused(rate_hz):
    arm = MockArm()
    with pytest.raises(InputError, match="rate"):
        run_loop(arm.robot, arm.guard, SwingTask(), arm.clock, MemoryLog(), rate_hz=rate_hz)


def test_slow_rate_works_and_the_rate_limit_restarts_in_each_run():
    arm = MockArm()
    log = MemoryLog()
    assert run_loop(arm.robot, arm.guard, SwingTask(done_at=1), arm.clock, log, rate_hz=0.9).ticks == 1
    arm = MockArm()
    run(arm, SwingTask(done_at=10, torque_nm=5.0))
    first = len(arm.sent_nm)
    run(arm, SwingTask(done_at=3, torque_nm=5.0))
    assert arm.sent_nm[first] == pytest.approx([3.0] * JOINTS)  # 3000 N m/s from zero, not from 5 N m


def test_run_is_read_back_with_units_and_events(tmp_path):
    arm, path = MockArm(), tmp_path / "run.mcap"
    with SessionWriter(path, [tick_stream(JOINTS)], SessionMetadata(), wait_for_room=True) as log:
        result = run_loop(
            arm.robot,
            arm.guard,
            SwingTask(fail_at=400),
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


def test_phase_numbers_match_existing_files():
    names = ("idle", "move", "approach", "loading", "hold", "unloading", "retract", "free_air", "stopped")
    assert [Phase(number).name.lower() for number in range(len(names))] == list(names)
