"""Control loop: in each tick, read the robot, step the task, apply the guard, and command the robot."""

import math
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from palpate.control.loop.result import LoopResult, Outcome
from palpate.control.loop.stop_handler import InterruptFlag, StopHandler
from palpate.control.loop.task import Phase, Task, TaskOutput, blank_output, checked_output
from palpate.control.loop.tick_record import NO_ESTIMATE, Journal, Observer, Tick, TickLog
from palpate.control.loop.timing import LoopTiming, TickDurations, TickGrid
from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import DeviceTimeoutError, InputError, SafetyTripError, error_text
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import Robot
from palpate.robot_io.types import Command, FloatArray, Measurement, Status

FIRST_SAMPLE_S = 1.0  # longest wait for a first sample that is recent enough
READ_SHARE = 0.6  # share of the period after which reading gives up, to leave time for the command


def run_loop(
    robot: Robot,
    guard: Guard,
    task: Task,
    clock: Clock,
    log: TickLog,
    *,
    rate_hz: float,
    observer: Observer | None = None,
    stop: Callable[[], str] = lambda: "",
) -> LoopResult:
    """Run a task until it is done, stopped or tripped; then switch the torque off.

    The task starts with the torque off. Then the robot is activated, and ticks run on a grid of absolute
    times. The run ends early after a trip of the guard, Ctrl-C (also SIGTERM, SIGHUP and Ctrl-Z; in the main
    thread only), a reason from `stop`, a failed device, or an exception or invalid output of the task. In
    all these cases the guard's safe state runs until it is finished. The robot is deactivated in every case.
    A failure of observer or log does not stop the arm: the observer is switched off, failures of the log are
    counted, and both are logged as an event.

    Args:
        robot: configured robot that is not active; on return it is deactivated, but not closed.
        guard: armed guard; after an early end it stays tripped until it is re-armed.
        task: task of the arm.
        clock: real or simulated time.
        log: receives the records of the stream "tick" and the events; it stays open.
        rate_hz: control rate [Hz].
        observer: called after each command.
        stop: called once per tick; a non-empty reason ends the run. On a real arm it watches the log.

    Returns:
        Result of the run; `LoopResult.raise_for_trip` raises an error for a bad end.

    Raises:
        InputError: the rate is not positive.
        SafetyTripError: the guard is already tripped.
        DeviceError: a device failed before the first tick, or had no sample within its age limit.
        KeyboardInterrupt: such a signal came when the task was already done.
        Exception: any exception of the task's start, such as `InputError` for a target out of reach.
    """
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"control rate {rate_hz} Hz: must be positive")
    if guard.tripped:
        raise SafetyTripError(f"the guard is tripped ({guard.tripped.cause}); re-arm it first")
    begun_s, begun_wall_s = clock.now_s(), perf_counter()
    with InterruptFlag() as interrupt:
        measurement = first_measurement(robot, guard, clock, 1.0 / rate_hz)
        journal = Journal(log, observer)
        stop_handler = StopHandler(guard, robot, clock, journal, interrupt=interrupt, stop=stop)
        loop = _Loop(task, stop_handler, 1.0 / rate_hz)
        loop.run(measurement)
        duration_s, wall_s = clock.now_s() - begun_s, perf_counter() - begun_wall_s
        result = replace(loop.result(), duration_s=duration_s, wall_s=wall_s)
        journal.event(clock.now_s(), "loop_ended", result.one_line())
    if interrupt.signal_name and result.outcome is Outcome.FINISHED:  # no further run may begin
        raise KeyboardInterrupt(interrupt.signal_name)
    return result


def first_measurement(robot: Robot, guard: Guard, clock: Clock, period_s: float) -> Measurement:
    """Read until every device has a sample that is recent enough for the guard.

    Samples that were buffered since the devices were opened are old, and some devices send only on request.

    Args:
        robot: configured robot.
        guard: guard with the age limits.
        clock: real or simulated time.
        period_s: time between reads [s].

    Raises:
        DeviceTimeoutError: a device has no recent sample within `FIRST_SAMPLE_S`; the error names it.
    """
    give_up_s = clock.now_s() + FIRST_SAMPLE_S
    while True:
        measurement = robot.read(clock.now_s() + period_s)
        problems = guard.too_old(measurement)
        if not problems:
            return measurement
        if clock.now_s() >= give_up_s:
            silent = "; ".join([*problems, *robot.bus_errors.values(), *robot.bus_delays.values()])
            raise DeviceTimeoutError(
                f"{robot.name}: not all devices sent a sample within {FIRST_SAMPLE_S:g} s: {silent}"
            )
        clock.sleep_until(clock.now_s() + period_s)


class _Loop:
    """One run of `run_loop`."""

    def __init__(self, task: Task, stop_handler: StopHandler, period_s: float) -> None:
        self._robot, self._guard, self._clock = stop_handler.robot, stop_handler.guard, stop_handler.clock
        self._journal, self._stop, self._task = stop_handler.journal, stop_handler, task
        self._period_s, self._grid = period_s, TickGrid(self._clock.now_s(), period_s)
        self._ticked_s = math.inf  # when the previous tick began, or the torque was switched on [s]
        self._timing = LoopTiming()
        self._reference_rad: FloatArray | None = None  # joint reference of the tick before
        self._log_s = 0.0  # duration of logging in the previous tick
        self._ticks = self._unsent = 0
        self._deactivation_error = ""
        self._joints = (self._robot.joint_count,)
        self._unknown = np.full(self._joints, np.nan)
        self._stopped_output = blank_output(*self._joints, Phase.STOPPED)  # while the guard commands

    def run(self, measurement: Measurement) -> None:
        """Run from the start of the task to torque off.

        Args:
            measurement: first measurement, with fresh samples.
        """
        self._measurement = measurement
        self._guard.watch(measurement)
        if not self._guard.tripped:
            self._guard.rearm(measurement)  # starts the rate limit from here rather than from an earlier run
        try:
            if not self._guard.tripped:  # otherwise the arm is never powered
                self._task.start(measurement)
                self._reference_rad = measurement.joint_position_rad  # the task starts here
                self._stop.check_requests()
            if not self._guard.tripped:
                self._robot.activate()
                self._ticked_s = self._clock.now_s()
                self._grid = TickGrid(self._ticked_s + self._period_s, self._period_s)
                self._stop.check_requests()  # nothing holds the arm yet, so that no safe stop is needed
                periods, ended = 1, self._guard.tripped is not None
                while not ended:
                    stopping = self._guard.tripped is not None
                    try:
                        self._clock.sleep_until(self._grid.due_s)
                        ended = self._tick(periods * self._period_s)
                    except BaseException as error:
                        self._stop.fail("the loop", error)  # sys.exit() must not drop the arm
                        ended = stopping  # a failure during the safe stop ends the run: torque off
                    periods = self._grid.advance(self._clock.now_s())
        finally:
            try:
                self._robot.deactivate()
            except Exception as error:
                self._deactivation_error = error_text(error)
                self._stop.fail("switching the torque off", error)
        try:
            self._robot.verify()
        except Exception as error:
            self._stop.fail("checking the devices after the run", error)

    def result(self) -> LoopResult:
        """Return the result without its times."""
        return LoopResult(
            outcome=self._stop.outcome,
            cause=self._stop.cause,
            ticks=self._ticks,
            overruns=self._grid.overruns,
            skipped=self._grid.skipped,
            dropped=self._journal.dropped,
            log_failures=self._journal.log_failures,
            log_error=self._journal.log_trouble,
            observer_error=self._journal.observer_error,
            unsent=self._unsent,
            deactivation_error=self._deactivation_error,
            timing=self._timing.summary(),
            error=self._stop.error,
        )

    def _tick(self, dt_s: float) -> bool:
        """Run one tick, `dt_s` [s] after the previous one; return whether it was the last tick."""
        guard = self._guard
        woken = perf_counter()
        now_s = self._clock.now_s()
        self._stop.check_requests()
        gap_s, self._ticked_s = now_s - self._ticked_s, now_s
        if gap_s > self._period_s + guard.longest_hold_up_s:  # the drives may have let go of the arm
            guard.trip(f"the program was held up for {gap_s:.3g} s before a tick")
        measurement = self._read(now_s)
        read = perf_counter()
        guard.watch(measurement, self._reference_rad)
        watched = perf_counter()
        output = self._stopped_output if guard.tripped else self._step(measurement, dt_s)
        stepped = perf_counter()
        held_s = (now_s := self._clock.now_s()) - measurement.time_s
        if held_s > guard.longest_hold_up_s:  # evaluated now, its samples are too old
            guard.trip(f"the program was held up for {held_s:.3g} s within a tick")
            measurement = measurement._replace(time_s=now_s)
        command = guard.limit(output.command, measurement, dt_s)
        limited = perf_counter()
        sent_nm = self._write(command, now_s)
        written = perf_counter()

        tripped = guard.tripped is not None
        if tripped:
            self._stop.log_trip()
            output = output._replace(phase=Phase.STOPPED)  # even if the guard rejected the task's command
        estimates = NO_ESTIMATE if tripped else self._journal.observe(measurement, output)
        observed = perf_counter()
        durations = TickDurations(
            read_s=read - woken,
            control_s=stepped - watched,
            guard_s=(watched - read) + (limited - stepped),
            write_s=written - limited,
            observer_s=observed - written,
            log_s=self._log_s,
            lateness_s=max(0.0, now_s - self._grid.due_s),
        )
        tick = Tick(self._grid.index, measurement, output, sent_nm, tripped, estimates, durations)
        self._journal.log_tick(tick)
        self._reference_rad = None if tripped else output.reference_position_rad
        self._ticks += 1
        self._timing.add(durations)
        self._log_s = perf_counter() - observed
        return guard.finished if tripped else output.done

    def _read(self, now_s: float) -> Measurement:
        """Read this tick's measurement; if that fails, mark the last one as stale."""
        try:
            self._measurement = self._robot.read(now_s + READ_SHARE * self._period_s)
        except Exception as error:
            self._stop.fail("reading the robot", error)
            stale = Status.STALE
            self._measurement = self._measurement._replace(
                time_s=now_s, encoder_status=stale, torque_status=stale, force_status=stale
            )
        return self._measurement

    def _step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        try:
            return checked_output(self._task.step(measurement, dt_s), self._joints)
        except BaseException as error:
            self._stop.fail("the task", error)
            return self._stopped_output

    def _write(self, command: Command, now_s: float) -> FloatArray:
        """Send a command; return the sent torques, shape (n,) [N m], NaN if sending failed."""
        try:
            return self._robot.write(command, now_s + self._period_s).joint_torque_nm
        except Exception as error:
            self._unsent += 1
            self._stop.fail("commanding the robot", error)
            return self._unknown
