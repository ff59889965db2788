"""Whatever fails, the arm is braked, its torque goes off within the stop time, and the cause is kept."""

import os
import signal

import numpy as np
import pytest

import control.loop.loop
from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.loop.result import Outcome
from robot_io.clock import MonotonicClock
from robot_io.errors import DeviceError, InputError, PalpateError, SafetyTripError
from robot_io.types import Command
from tests.control.loop_parts import AGE_LIMIT_S, RATE_HZ, STOP_TIME_S, Arm, MemoryLog, Swing

PERIOD_S = 1.0 / RATE_HZ


def run(arm, task, **options):
    log = MemoryLog()
    result = run_loop(arm.robot, arm.guard, task, arm.clock, log, rate_hz=RATE_HZ, **options)
    return result, log


def stop_began_s(log) -> float:
    return log.column("time_s")[np.flatnonzero(log.column("guard_tripped"))[0]]


def assert_came_to_rest(arm, log):
    """Braked, then off, within the stop time; then deactivated."""
    tripped = log.column("guard_tripped")
    assert (log.column("phase")[tripped] == Phase.STOPPED).all()
    assert log.column("time_s")[-1] - stop_began_s(log) <= STOP_TIME_S + PERIOD_S
    assert not arm.bus.powered
    assert (arm.plant.torque_nm == 0).all()
    speed_rad_s = np.abs(log.column("joint_velocity_rad_s")[tripped][0]).max()
    assert np.abs(arm.plant.velocity_rad_s).max() <= 0.5 * speed_rad_s


def test_an_exception_in_the_task_brakes_the_arm_and_is_chained():
    arm = Arm()
    result, log = run(arm, Swing(fail_at=100, torque_nm=0.5))
    assert result.outcome is Outcome.TRIPPED
    assert result.cause == "the task: ZeroDivisionError: the controller has a bug"
    assert log.texts("trip") == [result.cause]
    assert_came_to_rest(arm, log)
    braking = log.column("torque_sent_nm")[log.column("guard_tripped")][:-1, 2]
    assert (braking < 0).all()  # against the motion of joint 3
    with pytest.raises(PalpateError, match="the controller has a bug") as raised:
        result.raise_for_trip()
    assert isinstance(raised.value.__cause__, ZeroDivisionError)


def test_an_exception_at_the_start_of_the_task_is_passed_on_as_it_is_and_the_arm_not_powered():
    class BadStart(Swing):
        def start(self, measurement):
            raise InputError("target 2 is out of reach")

    arm = Arm()
    with pytest.raises(InputError, match="out of reach"):
        run(arm, BadStart())
    assert ("torque", "activate") not in arm.bus.calls
    assert arm.sent_nm == []


def test_an_exception_in_stop_is_a_reason_to_stop():
    arm = Arm()

    def stop():
        raise OSError("no such pipe")

    result, log = run(arm, Swing(), stop=stop)
    assert result.outcome is Outcome.TRIPPED
    assert "no such pipe" in result.cause
    assert_came_to_rest(arm, log)


def test_a_command_that_is_no_number_never_goes_out():
    class Diverging(Swing):
        def step(self, measurement, dt_s):
            self.torque_nm = np.nan if self.steps >= 50 else 0.1
            return super().step(measurement, dt_s)

    arm = Arm()
    result, log = run(arm, Diverging())
    assert result.outcome is Outcome.TRIPPED
    assert "nan" in result.cause
    assert np.isfinite(arm.sent_nm).all()
    assert_came_to_rest(arm, log)
    with pytest.raises(SafetyTripError):
        result.raise_for_trip()


def test_a_tracking_error_is_judged_against_the_reference_of_the_tick_before():
    class Jumping(Swing):
        def step(self, measurement, dt_s):
            output = super().step(measurement, dt_s)
            jump = 2.0 if self.steps == 50 else 0.0
            return output._replace(reference_position_rad=measurement.joint_position_rad + jump)

    arm, task = Arm(), Jumping(torque_nm=0.0)
    result, log = run(arm, task)
    assert "from its reference" in result.cause
    assert result.cause.endswith("See palpate doctor --move")  # what to do is said once, last, to everybody
    assert log.texts("trip") == [result.cause]
    assert task.steps == 50


def test_a_failing_observer_is_switched_off_and_the_task_goes_on():
    calls = []

    def observe(measurement, output):
        calls.append(measurement.time_s)
        raise FloatingPointError("singular")

    arm = Arm()
    result, log = run(arm, Swing(done_at=50), observer=observe)
    assert result.outcome is Outcome.FINISHED
    assert result.ticks == 50
    assert len(calls) == 1
    assert result.observer_error == "FloatingPointError: singular"
    assert len(log.texts("observer_failed")) == 1


def test_an_observer_that_returns_nonsense_is_switched_off_too():
    result, log = run(Arm(), Swing(done_at=5), observer=lambda *_: (1.0, 2.0))
    assert result.outcome is Outcome.FINISHED
    assert "ValueError" in result.observer_error
    assert np.isnan(log.column("surface_m")).all()


def test_a_log_that_fails_is_counted_and_does_not_stop_the_arm():
    arm, log = Arm(), MemoryLog()
    log.error = OSError(28, "No space left on device")
    result = run_loop(arm.robot, arm.guard, Swing(done_at=50), arm.clock, log, rate_hz=RATE_HZ)
    assert result.outcome is Outcome.FINISHED
    assert (result.ticks, result.log_failures) == (50, 50)
    assert "No space left" in result.log_error
    assert len(log.texts("log_failed")) == 1
    assert "No space left" in result.one_line()


def test_a_log_of_which_nothing_works_does_not_stop_the_arm_either():
    class Broken(MemoryLog):
        def append(self, stream_name, record):
            raise OSError("gone")

        def event(self, *_):
            raise OSError("gone")

    arm = Arm()
    result = run_loop(arm.robot, arm.guard, Swing(done_at=50), arm.clock, Broken(), rate_hz=RATE_HZ)
    assert result.outcome is Outcome.FINISHED
    assert result.ticks == 50


def test_a_disk_that_failed_behind_the_log_is_in_the_result():
    arm, log = Arm(), MemoryLog()
    log.failure = "the disk is full"
    log.dropped = 7
    result = run_loop(arm.robot, arm.guard, Swing(done_at=5), arm.clock, log, rate_hz=RATE_HZ)
    assert (result.log_error, result.dropped) == ("the disk is full", 7)


def test_a_stale_sensor_trips_within_its_age_limit_and_two_ticks():
    arm, task = Arm(), Swing()

    def stall():
        arm.faults.silent = {"force"} if task.steps >= 30 else set()

    arm.on_poll = stall
    result, log = run(arm, task)
    assert "force sensor" in result.cause
    assert stop_began_s(log) - log.column("force_at_s")[-1] <= AGE_LIMIT_S + 2 * PERIOD_S
    assert_came_to_rest(arm, log)
    assert len(set(log.column("force_at_s")[-10:])) == 1  # on record with the time of the old sample
    assert (log.column("force_status")[-10:] == 1).all()


def test_a_bus_that_fails_in_reading_trips_and_is_named():
    arm, task = Arm(), Swing()

    def unplug():
        arm.faults.unplugged = task.steps == 30

    arm.on_poll = unplug
    result, log = run(arm, task)
    assert result.outcome is Outcome.TRIPPED
    assert "unplugged" in result.cause
    assert task.steps == 30
    assert result.unsent == log.column("guard_tripped").sum() > STOP_TIME_S * RATE_HZ / 2  # tried each tick
    assert not arm.bus.powered


def test_a_driver_bug_in_reading_trips_and_shows_old_values_as_old():
    arm, task = Arm(), Swing()

    def fail():
        if task.steps == 30:
            raise IndexError("bug in a driver")

    arm.on_poll = fail
    result, log = run(arm, task)
    assert result.cause == "reading the robot: IndexError: bug in a driver"
    assert isinstance(result.error, IndexError)
    assert (log.column("encoder_status")[30:] == 1).all()
    braking = log.column("torque_sent_nm")[30:, 2]
    assert (braking[:4] < 0).all()  # as long as the last velocity is fresh enough
    assert (braking[10:] == 0).all()
    assert not arm.bus.powered


def test_commands_that_cannot_be_sent_are_tried_each_tick_and_counted():
    arm, task = Arm(), Swing()

    def unplug():
        if task.steps == 30:
            raise DeviceError("bus off")

    arm.on_flush = unplug
    result, log = run(arm, task)
    assert result.outcome is Outcome.TRIPPED
    assert "bus off" in result.cause
    stopped = int(log.column("guard_tripped").sum())
    assert result.unsent == stopped > STOP_TIME_S * RATE_HZ / 2
    assert np.isnan(log.column("torque_sent_nm")[-1]).all()
    assert arm.bus.calls.count(("torque", "deactivate")) == 1
    assert len(log.texts("failure")) <= 1  # not one a tick
    assert f"{stopped} commands not sent" in result.one_line()


def test_torque_that_could_not_be_switched_off_is_never_called_a_good_end():
    arm = Arm()
    arm.faults.refuse.add(("torque", "deactivate"))
    result, _ = run(arm, Swing(done_at=20))
    assert result.outcome is Outcome.TRIPPED
    assert "refuses to deactivate" in result.deactivation_error
    assert "the torque may still be on" in result.one_line()
    with pytest.raises(SafetyTripError, match="cut the power"):
        result.raise_for_trip()


def test_a_robot_that_does_not_activate_is_deactivated_and_the_reason_passed_on():
    arm = Arm()
    arm.faults.refuse.add(("torque", "activate"))
    with pytest.raises(DeviceError, match="refuses to activate"):
        run(arm, Swing())
    assert ("torque", "deactivate") in arm.bus.calls
    assert arm.sent_nm == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_is_a_safe_stop_that_a_second_one_does_not_shorten(number):
    arm, task = Arm(), Swing(torque_nm=0.5)

    def press():
        if task.steps == 100:  # at each poll of the stop again
            os.kill(os.getpid(), number)

    arm.on_poll = press
    before = signal.getsignal(number)
    result, log = run(arm, task)
    assert result.outcome is Outcome.STOPPED
    assert result.cause == f"interrupted by the user ({number.name})"
    assert log.texts("stop") == [result.cause]
    assert_came_to_rest(arm, log)
    assert log.column("time_s")[-1] - stop_began_s(log) >= STOP_TIME_S - 2 * PERIOD_S
    assert signal.getsignal(number) is before


def test_the_first_cause_is_kept():
    arm, task = Arm(), Swing(fail_at=40)

    def press():
        if task.steps == 40:
            os.kill(os.getpid(), signal.SIGINT)
            arm.plant.hand_force_n = 1e3

    arm.on_poll = press
    result, _ = run(arm, task)
    assert "ZeroDivisionError" in result.cause
    assert result.outcome is Outcome.TRIPPED


def test_the_same_loop_runs_on_the_machine_s_clock():
    # no torque: an arm that a busy machine leaves alone must not reach its limits
    arm, task = Arm(MonotonicClock(), age_limit_s=1.0), Swing(done_at=50, torque_nm=0.0)
    result, log = run(arm, task)
    assert result.outcome is Outcome.FINISHED
    assert len(log.records) == 50
    assert (np.diff(log.column("time_s")) > 0.0).all()
    assert (log.column("lateness_s") > 0.0).any()  # nobody wakes up to the nanosecond


def test_ctrl_c_on_the_machine_s_clock_leads_to_the_same_safe_stop():
    arm, task = Arm(MonotonicClock(), age_limit_s=1.0), Swing(torque_nm=0.0)

    def press():
        if task.steps >= 20:
            os.kill(os.getpid(), signal.SIGINT)

    arm.on_poll = press
    result, log = run(arm, task)
    assert result.outcome is Outcome.STOPPED
    assert not arm.bus.powered
    assert (log.column("torque_sent_nm")[-1] == 0).all()


BAD_RESULTS = {
    "nothing": (lambda _output: None, "step returned a NoneType"),
    "a short reference": (
        lambda output: output._replace(reference_position_rad=np.zeros(2)),
        r"reference_position_rad of shape (2,), expected (3,)",
    ),
    "a speed that is none": (
        lambda output: output._replace(reference_velocity_rad_s=0.0),
        "reference_velocity_rad_s of type float",
    ),
    "a command of five": (lambda output: output._replace(command=Command(np.zeros(5))), "command of shape"),
    "a command in a list": (
        lambda output: output._replace(command=Command([0.0] * 3)),
        "command of type list",
    ),
    "a bare command": (lambda output: output._replace(command=np.zeros(3)), "command of type ndarray"),
    "a flat tip": (lambda output: output._replace(tip_position_world_m=np.zeros(2)), "tip_position_world_m"),
    "a phase in words": (lambda output: output._replace(phase="hold"), "phase of type str"),
    "no force": (lambda output: output._replace(desired_force_n=None), "desired_force_n of type NoneType"),
    "a run in words": (lambda output: output._replace(run="first"), "run of type str"),
    "no events": (lambda output: output._replace(events=None), "events of type NoneType"),
    "an event in words": (lambda output: output._replace(events=("touch",)), "events of type str"),
}


@pytest.mark.parametrize("kind", BAD_RESULTS)
def test_a_result_that_is_of_no_use_brakes_the_arm_like_an_exception(kind):
    spoil, words = BAD_RESULTS[kind]

    class Spoilt(Swing):
        def step(self, measurement, dt_s):
            output = super().step(measurement, dt_s)
            return spoil(output) if self.steps >= 100 else output

    arm = Arm()
    result, log = run(arm, Spoilt(torque_nm=0.5))
    assert result.outcome is Outcome.TRIPPED
    assert result.cause.startswith("the task: ")
    assert words in result.cause
    assert log.texts("trip") == [result.cause]
    assert_came_to_rest(arm, log)
    assert log.column("guard_tripped").sum() > STOP_TIME_S * RATE_HZ / 2
    assert len(log.records) == result.ticks
    assert not result.log_error


def test_a_fault_of_the_loop_itself_brakes_the_arm_too(monkeypatch):
    made = control.loop.loop.tick_record
    calls = []

    def faulty_record(*parts):
        calls.append(parts)
        if len(calls) == 100:
            raise IndexError("a bug in the loop")
        return made(*parts)

    monkeypatch.setattr(control.loop.loop, "tick_record", faulty_record)
    arm = Arm()
    result, log = run(arm, Swing(torque_nm=0.5))
    assert result.cause == "the loop: IndexError: a bug in the loop"
    assert_came_to_rest(arm, log)
    assert log.column("guard_tripped").sum() > STOP_TIME_S * RATE_HZ / 2


def test_a_guard_that_fails_while_it_stops_the_arm_leaves_the_torque_off_at_once():
    arm, task = Arm(), Swing(fail_at=50)
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
