"""Control loop failures: the arm is braked, torque goes off in time, and the cause is reported."""

import asyncio
import os
import signal
import threading
from functools import partial
from itertools import count

import numpy as np
import pytest

from palpate.control.loop import tick_record
from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import Outcome
from palpate.control.loop.stop_handler import InterruptFlag
from palpate.control.loop.task import Phase
from palpate.robot_io.clock import MonotonicClock
from palpate.robot_io.errors import DeviceError, InputError, PalpateError, SafetyTripError
from palpate.robot_io.types import Command
from tests.control.loop_parts import AGE_LIMIT_S, RATE_HZ, STOP_TIME_S, MemoryLog, MockArm, SwingTask

PERIOD_S = 1.0 / RATE_HZ


def run(arm, task, **options):
    log = MemoryLog()
    return run_loop(arm.robot, arm.guard, task, arm.clock, log, rate_hz=RATE_HZ, **options), log


def stop_began_s(log) -> float:
    return log.column("time_s")[np.flatnonzero(log.column("guard_tripped"))[0]]


def assert_came_to_rest(arm, log):
    """Braked, then off, within the stop time; then deactivated."""
    tripped = log.column("guard_tripped")
    assert (log.column("phase")[tripped] == Phase.STOPPED).all()
    assert log.column("run")[-1] == -1
    (stopped_at_s,) = (time_s for time_s, kind, _ in log.events if kind in {"stop", "trip"})
    assert stopped_at_s == stop_began_s(log)
    assert log.column("time_s")[-1] - stop_began_s(log) <= STOP_TIME_S + PERIOD_S
    assert not arm.bus.powered
    assert (arm.plant.torque_nm == 0).all()
    speed_rad_s = np.abs(log.column("joint_velocity_rad_s")[tripped][0]).max()
    assert np.abs(arm.plant.velocity_rad_s).max() <= 0.5 * speed_rad_s


def raising(error):
    def fail(*_arguments):
        raise error

    return fail


class Spoilt(SwingTask):
    """From a tick on another thing is made of its output."""

    def __init__(self, spoil, since=100, **options):
        super().__init__(**{"torque_nm": 0.5} | options)
        self.spoil, self.since = spoil, since

    def step(self, measurement, dt_s):
        output = super().step(measurement, dt_s)
        return self.spoil(output) if self.steps >= self.since else output


def test_task_exception_brakes_the_arm_and_is_chained():
    arm = MockArm()
    result, log = run(arm, SwingTask(fail_at=100, torque_nm=0.5))
    assert result.outcome is Outcome.TRIPPED
    assert result.cause == "the task: ZeroDivisionError: the controller has a bug"
    assert log.texts("trip") == [result.cause]
    assert_came_to_rest(arm, log)
    braking = log.column("torque_sent_nm")[log.column("guard_tripped")][:-1, 2]
    assert (braking < 0).all()  # against the motion of joint 3
    with pytest.raises(PalpateError, match="the controller has a bug") as raised:
        result.raise_for_trip()
    assert isinstance(raised.value.__cause__, ZeroDivisionError)


@pytest.mark.parametrize("error", [SystemExit(7), asyncio.CancelledError("")])
def test_task_that_exits_brakes_the_arm_first(error):
    arm, task = MockArm(), SwingTask(torque_nm=0.5)
    task.step = raising(error)
    result, log = run(arm, task)
    said = f"the task: RuntimeError: {type(error).__name__} {error}".strip()
    assert (result.outcome, result.cause) == (Outcome.TRIPPED, said)
    assert log.texts("trip") == [result.cause]
    assert_came_to_rest(arm, log)


def test_failure_before_the_first_tick_propagates():
    arm, task = MockArm(), SwingTask()
    task.start = raising(InputError("target 2 is out of reach"))
    with pytest.raises(InputError, match="out of reach"):
        run(arm, task)
    assert ("torque", "activate") not in arm.bus.calls
    assert arm.sent_nm == []
    arm = MockArm()
    arm.faults.refuse.add(("torque", "activate"))
    with pytest.raises(DeviceError, match="refuses to activate"):
        run(arm, SwingTask())
    assert ("torque", "deactivate") in arm.bus.calls
    assert arm.sent_nm == []


def test_device_that_was_changed_during_a_run_is_reported():
    arm = MockArm()
    arm.faults.refuse.add(("force", "verify"))
    result, log = run(arm, SwingTask(done_at=20))
    said = "checking the devices after the run: mock force refuses to verify"
    assert (result.outcome, result.cause, log.texts("trip")) == (Outcome.TRIPPED, said, [said])
    assert not result.deactivation_error
    assert not arm.bus.powered


@pytest.mark.parametrize("held_s", [0.04, 0.2])
def test_command_computed_before_a_stall_is_not_sent(held_s):
    arm, task = MockArm(), SwingTask(done_at=120)
    compute = task.step

    def held_up(measurement, dt_s):
        output = compute(measurement, dt_s)
        if task.steps == 100:
            arm.clock.sleep_until(arm.clock.now_s() + held_s)
        return output

    task.step = held_up
    result, log = run(arm, task)
    if held_s < 0.1:
        assert (result.outcome, result.overruns, result.ticks) == (Outcome.FINISHED, 1, 120)
        return
    assert result.cause == "the program was held up for 0.2 s within a tick"
    assert (arm.sent_nm[99] == 0).all()  # nobody knows any more how the arm moves
    assert log.column("torque_commanded_nm")[99].all()


@pytest.mark.parametrize(("where", "after"), [("flush", 100), ("sleep", 100), ("sleep", 0)])
@pytest.mark.parametrize("held_s", [0.09, 0.2])
def test_stall_before_a_tick_stops_the_arm(where, after, held_s):
    """As after Ctrl-Z and fg: the task went on where its reference was by then, or started after a stall."""
    arm, task = MockArm(), SwingTask(done_at=120, torque_nm=0.0)
    sleep_until = arm.clock.sleep_until

    def stall(time_s=0.0):
        if where == "flush":
            time_s = arm.clock.now_s()
        sleep_until(time_s + held_s * (arm.bus.powered and task.steps == after))

    if where == "flush":
        arm.on_flush = stall
    else:
        arm.clock.sleep_until = stall
    result, _ = run(arm, task)
    assert (result.outcome is Outcome.FINISHED) == (held_s < 0.1)
    said = "the program was held up for 0.201 s before a tick"
    assert held_s < 0.1 or (result.cause, task.steps) == (said, after)


def test_exception_in_stop_is_a_reason_to_stop():
    arm, task, fail = MockArm(), SwingTask(), raising(OSError("no such pipe"))
    result, log = run(arm, task, stop=lambda: fail() if task.steps == 50 else "")
    assert result.outcome is Outcome.TRIPPED
    assert "no such pipe" in result.cause
    assert_came_to_rest(arm, log)


def test_nonfinite_command_is_never_sent():
    arm, diverged = MockArm(), Command(np.full(3, np.nan))
    result, log = run(arm, Spoilt(lambda output: output._replace(command=diverged), 50, torque_nm=0.1))
    assert result.outcome is Outcome.TRIPPED
    assert "nan" in result.cause
    assert np.isfinite(arm.sent_nm).all()
    assert_came_to_rest(arm, log)
    with pytest.raises(SafetyTripError):
        result.raise_for_trip()


def test_tracking_error_is_judged_against_the_previous_reference():
    def jump(output):
        return output._replace(reference_position_rad=output.reference_position_rad + 2.0)

    task = Spoilt(jump, 50, torque_nm=0.0)
    result, log = run(MockArm(), task)
    assert "off its reference" in result.cause
    assert result.cause.endswith("Run palpate doctor --move")  # what to do is said once, last, to everybody
    assert log.texts("trip") == [result.cause]
    assert task.steps == 50


@pytest.mark.parametrize(
    ("observe", "error"),
    [
        (raising(FloatingPointError("singular\n\x1b[2J")), "FloatingPointError: singular ?[2J"),
        (lambda *_: (1.0, 2.0), "ValueError"),
    ],
)
def test_failing_observer_is_disabled_and_the_task_continues(observe, error):
    calls = []
    result, log = run(
        MockArm(), SwingTask(done_at=50), observer=lambda *seen: calls.append(seen) or observe(*seen)
    )
    assert (result.outcome, result.ticks, len(calls)) == (Outcome.FINISHED, 50, 1)
    assert error in result.observer_error
    assert len(log.texts("observer_failed")) == 1
    assert np.isnan(log.column("surface_m")).all()


def test_failing_log_is_counted_and_does_not_stop_the_arm():
    arm, log = MockArm(), MemoryLog()
    log.error = OSError(28, "No space left on device")
    result = run_loop(arm.robot, arm.guard, SwingTask(done_at=50), arm.clock, log, rate_hz=RATE_HZ)
    assert (result.outcome, result.ticks, result.log_failures) == (Outcome.FINISHED, 50, 50)
    assert len(log.texts("log_failed")) == 1
    assert all("No space left" in said for said in (result.log_error, result.one_line()))
    arm, log = MockArm(), MemoryLog()
    log.append = log.event = raising(OSError("gone"))
    result = run_loop(arm.robot, arm.guard, SwingTask(done_at=50), arm.clock, log, rate_hz=RATE_HZ)
    assert (result.outcome, result.ticks) == (Outcome.FINISHED, 50)
    arm, log = MockArm(), MemoryLog()
    log.event = raising(OSError("gone"))
    result = run_loop(arm.robot, arm.guard, SwingTask(done_at=2), arm.clock, log, rate_hz=RATE_HZ)
    assert (result.log_failures, result.log_error) == (0, "")  # nothing has happened yet
    result = run_loop(arm.robot, arm.guard, SwingTask(done_at=50), arm.clock, log, rate_hz=RATE_HZ)
    assert result.log_failures == 2  # the touch, and that it was not logged
    assert result.log_error == "OSError: gone"


def test_failed_disk_behind_the_log_is_in_the_result():
    arm, log = MockArm(), MemoryLog()
    log.failure, log.dropped = "the disk is full", 7
    result = run_loop(arm.robot, arm.guard, SwingTask(done_at=5), arm.clock, log, rate_hz=RATE_HZ)
    assert (result.log_error, result.dropped) == ("the disk is full", 7)


def test_stale_sensor_trips_within_its_age_limit_and_two_ticks():
    arm, task = MockArm(), SwingTask()
    arm.on_poll = lambda: arm.faults.silent.update({"force"} if task.steps >= 30 else ())
    result, log = run(arm, task)
    assert "force sensor" in result.cause
    assert stop_began_s(log) - log.column("force_at_s")[-1] <= AGE_LIMIT_S + 2 * PERIOD_S
    assert_came_to_rest(arm, log)
    assert len(set(log.column("force_at_s")[-10:])) == 1  # on record with the time of the old sample
    assert (log.column("force_status")[-10:] == 1).all()


def test_failing_bus_trips_and_is_named():
    arm, task = MockArm(), SwingTask()
    arm.on_poll = lambda: setattr(arm.faults, "unplugged", task.steps == 30)
    result, log = run(arm, task)
    assert result.outcome is Outcome.TRIPPED
    assert "unplugged" in result.cause
    assert task.steps == 30
    assert result.unsent == log.column("guard_tripped").sum() > STOP_TIME_S * RATE_HZ / 2  # tried each tick
    assert not arm.bus.powered


def test_driver_bug_in_reading_trips_and_old_values_are_marked_old():
    arm, task = MockArm(), SwingTask()
    fail = raising(IndexError("bug in a driver"))
    arm.on_poll = lambda: fail() if task.steps == 30 else None
    result, log = run(arm, task)
    assert result.cause == "reading the robot: IndexError: bug in a driver"
    assert isinstance(result.error, IndexError)
    assert (log.column("encoder_status")[30:] == 1).all()
    braking = log.column("torque_sent_nm")[30:, 2]
    assert (braking[:4] < 0).all()  # as long as the last velocity is fresh enough
    assert (braking[10:] == 0).all()
    assert not arm.bus.powered


def test_failing_commands_are_retried_each_tick_and_counted():
    arm, task = MockArm(), SwingTask()
    unplug = raising(DeviceError("bus off"))
    arm.on_flush = lambda: unplug() if task.steps == 30 else None
    result, log = run(arm, task)
    assert result.outcome is Outcome.TRIPPED
    assert "bus off" in result.cause
    stopped = int(log.column("guard_tripped").sum())
    assert result.unsent == stopped > STOP_TIME_S * RATE_HZ / 2
    assert np.isnan(log.column("torque_sent_nm")[-1]).all()
    assert arm.bus.calls.count(("torque", "deactivate")) == 1
    assert len(log.texts("failure")) <= 1  # not one a tick
    assert f"{stopped} commands not sent" in result.one_line()


def test_stop_cause_is_reported_with_a_failed_torque_off():
    arm = MockArm()
    arm.faults.refuse.add(("torque", "deactivate"))
    result, _ = run(arm, SwingTask(done_at=20))
    assert result.outcome is Outcome.TRIPPED
    assert "refuses to deactivate" in result.deactivation_error
    assert "the torque may still be on" in result.one_line()
    with pytest.raises(SafetyTripError, match="cut the power") as raised:
        result.raise_for_trip()
    assert str(raised.value).count("refuses to deactivate") == 1  # said once, though it is the cause as well
    arm = MockArm()
    arm.faults.refuse.add(("torque", "deactivate"))
    result, _ = run(arm, SwingTask(fail_at=20))
    with pytest.raises(SafetyTripError, match=r"cut the power.*; the arm was stopped: the task: Zero"):
        result.raise_for_trip()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP])
def test_second_ctrl_c_does_not_shorten_the_safe_stop(number):
    arm, task = MockArm(), SwingTask(torque_nm=0.5)

    def press():
        if task.steps == 100:  # at each poll of the stop again
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), signal.SIGINT)

    arm.on_poll = press
    callers = lambda *_: None  # noqa: E731
    before = signal.signal(number, callers)
    result, log = run(arm, task)
    assert signal.signal(number, before) is callers
    assert result.outcome is Outcome.STOPPED
    assert result.cause == f"interrupted by the user ({number.name})"
    assert log.texts("stop") == [result.cause]
    assert_came_to_rest(arm, log)
    assert log.column("time_s")[-1] - stop_began_s(log) >= STOP_TIME_S - 2 * PERIOD_S


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("when", ["last tick", "switching off"])
def test_signal_at_the_end_of_a_run_allows_no_further_run(number, when):
    """A program that probes several times went on after Ctrl-C."""
    arm, task = MockArm(), SwingTask(done_at=100)
    press, deactivate = partial(os.kill, os.getpid(), number), arm.robot.deactivate
    if when == "last tick":
        arm.on_flush = lambda: press() if task.steps == 100 else None
    else:
        arm.robot.deactivate = lambda: press() or deactivate()
    with pytest.raises(KeyboardInterrupt, match=number.name):
        run(arm, task)
    assert not arm.bus.powered


@pytest.mark.parametrize("when", ["start", "activate"])
def test_signal_before_the_first_tick_moves_nothing(when):
    """The arm was powered after Ctrl-C, and its weight held up for the whole safe stop."""
    arm, task = MockArm(), SwingTask()
    press = partial(os.kill, os.getpid(), signal.SIGINT)
    if when == "start":
        task.start = lambda _: press()
    else:
        activate = arm.robot.activate
        arm.robot.activate = lambda: press() or activate()
    result, log = run(arm, task)
    assert (result.outcome, result.cause) == (Outcome.STOPPED, "interrupted by the user (SIGINT)")
    assert log.texts("stop") == [result.cause]
    assert (("torque", "activate") in arm.bus.calls) == (when == "activate")
    assert (arm.sent_nm, arm.bus.powered) == ([], False)


def test_arm_that_was_moved_during_its_activation_is_not_pulled_back():
    """The first tick had no reference: the arm was commanded to where it had been before."""
    arm, task = MockArm(), SwingTask(torque_nm=0.5)
    activate = arm.robot.activate

    def moved():
        activate()
        arm.plant.angle_rad[1:] -= 0.5

    arm.robot.activate = moved
    result, _ = run(arm, task)
    assert "joint 2 is 0.5 rad off its reference" in result.cause
    assert task.steps == 0


def test_first_cause_of_a_stop_is_reported():
    arm, task = MockArm(), SwingTask(fail_at=40)

    def press():
        if task.steps == 40:
            os.kill(os.getpid(), signal.SIGINT)
            arm.plant.hand_force_n = 1e3

    arm.on_poll = press
    result, _ = run(arm, task)
    assert "ZeroDivisionError" in result.cause
    assert result.outcome is Outcome.TRIPPED


@pytest.mark.parametrize("outcome", [Outcome.FINISHED, Outcome.STOPPED])
def test_loop_runs_and_stops_on_the_monotonic_clock(outcome):
    # no torque: an arm that a busy machine leaves alone must not reach its limits
    arm, task = MockArm(MonotonicClock(), age_limit_s=10.0), SwingTask(done_at=50, torque_nm=0.0)
    if outcome is Outcome.STOPPED:
        press = partial(os.kill, os.getpid(), signal.SIGINT)
        arm.on_poll = lambda: press() if task.steps >= 20 else None
    result, log = run(arm, task)
    assert result.outcome is outcome
    assert len(log.records) == 50 or outcome is Outcome.STOPPED
    assert not arm.bus.powered
    assert (log.column("torque_sent_nm")[-1] == 0).all()
    assert (np.diff(log.column("time_s")) > 0.0).all()
    assert (log.column("lateness_s") > 0.0).any()  # nobody wakes up to the nanosecond


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reference_position_rad": np.zeros(2)}, "reference_position_rad of shape (2,), expected (3,)"),
        ({"reference_velocity_rad_s": 0.0}, "reference_velocity_rad_s of type float"),
        ({"command": Command(np.zeros(5))}, "command of shape"),
        ({"command": Command([0.0] * 3)}, "command of type list"),
        ({"command": np.zeros(3)}, "command of type ndarray"),
        ({"tip_position_world_m": np.zeros(2)}, "tip_position_world_m"),
        ({"phase": "hold"}, "phase of type str, expected: Phase"),
        ({"desired_force_n": None}, "desired_force_n of type NoneType, expected: number"),
        ({"run": "first"}, "run of type str, expected: whole number"),
        ({"events": None}, "events of type NoneType"),
        ({"events": ("touch",)}, "events of type str"),
        (None, "step returned a NoneType"),
    ],
)
def test_invalid_task_result_brakes_the_arm_like_an_exception(changes, words):
    arm = MockArm()
    task = Spoilt(lambda output: None if changes is None else output._replace(**changes))
    result, log = run(arm, task)
    assert result.outcome is Outcome.TRIPPED
    assert result.cause.startswith("the task: ")
    assert words in result.cause
    assert log.texts("trip") == [result.cause]
    assert_came_to_rest(arm, log)
    assert log.column("guard_tripped").sum() > STOP_TIME_S * RATE_HZ / 2
    assert len(log.records) == result.ticks
    assert not result.log_error


def test_loop_fault_brakes_the_arm(monkeypatch):
    made, calls = tick_record.tick_record, count(1)
    fail = raising(IndexError("a bug in the loop"))
    monkeypatch.setattr(tick_record, "tick_record", lambda tick: fail() if next(calls) == 100 else made(tick))
    arm = MockArm()
    result, log = run(arm, SwingTask(torque_nm=0.5))
    assert result.cause == "the loop: IndexError: a bug in the loop"
    assert_came_to_rest(arm, log)
    assert log.column("guard_tripped").sum() > STOP_TIME_S * RATE_HZ / 2


def test_guard_failure_during_the_stop_leaves_the_torque_off():
    arm, task = MockArm(), SwingTask(fail_at=50)
    limit = arm.guard.limit

    def faulty_limit(command, measurement, dt_s):
        if arm.guard.tripped and task.steps == 50:
            raise FloatingPointError("a bug in the safe stop")
        return limit(command, measurement, dt_s)

    arm.guard.limit = faulty_limit
    result, log = run(arm, task)
    assert "the controller has a bug" in result.cause
    assert len(log.texts("failure")) == 1
    assert "a bug in the safe stop" in log.texts("failure")[0]
    assert result.ticks < 55
    assert not arm.bus.powered


def test_ignored_signal_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    try:
        with InterruptFlag() as flag:
            os.kill(os.getpid(), signal.SIGHUP)
            assert flag.signal_name is None
    finally:
        signal.signal(signal.SIGHUP, before)


def test_outside_the_main_thread_handlers_are_left_alone():
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def run():
        with InterruptFlag() as flag:
            seen.append((signal.getsignal(signal.SIGINT), flag.signal_name))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [(before, None)]
