"""The loop: read the robot, ask the task, let the guard decide, command the robot; tick after tick."""

import math
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from control.loop.journal import Journal, Observer, TickLog
from control.loop.phases import Phase
from control.loop.result import LoopResult
from control.loop.task import Task, TaskOutput, aimless_output, checked_output
from control.loop.tick_record import NO_ESTIMATE, tick_record
from control.loop.timing import LoopTiming, TickDurations, TickGrid
from control.loop.way_out import InterruptFlag, WayOut, one_line
from robot_io.clock import Clock
from robot_io.errors import DeviceTimeoutError, InputError, SafetyTripError
from robot_io.guard import Guard
from robot_io.robot import Robot
from robot_io.types import Command, FloatArray, Measurement, Status

FIRST_SAMPLE_S = 1.0  # how long the devices may take to a first sample that is young enough
READ_SHARE = 0.6  # of the period; then reading gives up, so that there is still time to command


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
    """Run a task until it is done, stopped or tripped; then see that the torque is off.

    The task is started with the torque still off; then the robot is activated and ticks run on a grid of
    absolute times. A trip of the guard, Ctrl-C (also SIGTERM and SIGHUP; in the main thread only), `stop`, a
    device that fails, an exception in the task or a result of it that is of no use all take one way out: the
    guard's safe state, tick after tick until it is finished, then deactivation, which is tried whatever
    happened before. Trouble with observer or log stops nothing by itself: the observer is switched off, the
    log's failures are counted, both with an event. Who moves a real arm lets `stop` ask for its log.

    The robot is configured and not active; on return it is deactivated, not closed. The guard is armed;
    unless the task was done it is tripped on return, until it is re-armed. The log takes the records of the
    stream "tick" and the events, and stays open. The observer is called after each command; `stop` is asked
    once a tick, and ends the run by giving a reason that is not empty.

    Returns:
        How it ended; `LoopResult.raise_for_trip` turns a bad end into an error.

    Raises:
        InputError: the rate is not positive.
        SafetyTripError: the guard is tripped already.
        DeviceError: a device failed before the first tick, or had no sample within its age limit.
        Exception: whatever the task raised at its start, such as `InputError` for a target out of reach.
    """
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"control rate {rate_hz} Hz: must be positive")
    if guard.tripped:
        raise SafetyTripError(f"the guard is tripped ({guard.tripped.cause}): re-arm it first")
    begun_s, begun_wall_s = clock.now_s(), perf_counter()
    with InterruptFlag() as interrupt:
        measurement = first_measurement(robot, guard, clock, 1.0 / rate_hz)
        journal = Journal(log, observer)
        way_out = WayOut(guard, robot, clock, journal, interrupt=interrupt, stop=stop)
        loop = _Loop(task, way_out, 1.0 / rate_hz)
        loop.run(measurement)
        duration_s, wall_s = clock.now_s() - begun_s, perf_counter() - begun_wall_s
        result = replace(loop.result(), duration_s=duration_s, wall_s=wall_s)
        journal.event(clock.now_s(), "loop_ended", result.one_line())
    return result


def first_measurement(robot: Robot, guard: Guard, clock: Clock, period_s: float) -> Measurement:
    """Read, every `period_s` [s], until every device has a sample that the guard takes as young enough.

    What has waited in a line since the devices were opened is old, and some speak only when they are asked.

    DeviceTimeoutError: some have none within `FIRST_SAMPLE_S`, by name.
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
                f"{robot.name}: no samples to begin with after {FIRST_SAMPLE_S:g} s: {silent}"
            )
        clock.sleep_until(clock.now_s() + period_s)


class _Loop:
    """One run of `run_loop`."""

    def __init__(self, task: Task, way_out: WayOut, period_s: float) -> None:
        self._robot, self._guard, self._clock = way_out.robot, way_out.guard, way_out.clock
        self._journal, self._way_out, self._task = way_out.journal, way_out, task
        self._period_s, self._grid = period_s, TickGrid(self._clock.now_s(), period_s)
        self._timing = LoopTiming()
        self._reference_rad: FloatArray | None = None  # what the joints were to follow in the tick before
        self._log_s = 0.0  # of the tick before
        self._ticks = self._unsent = 0
        self._deactivation_error = ""
        self._joints = (self._robot.joint_count,)
        self._unknown = np.full(self._joints, np.nan)
        self._stopped_output = aimless_output(*self._joints, Phase.STOPPED)  # while the guard commands

    def run(self, measurement: Measurement) -> None:
        """Everything from the start of the task to torque off."""
        self._measurement = measurement
        self._guard.watch(measurement)
        if not self._guard.tripped:
            self._guard.rearm(measurement)  # the rate limit starts from here, not from an earlier run
        try:
            if not self._guard.tripped:  # else the arm is never powered
                self._task.start(measurement)
                self._robot.activate()
                self._spin()
        finally:
            self._deactivate()

    def result(self) -> LoopResult:
        """How it ended, but for the times."""
        return LoopResult(
            outcome=self._way_out.outcome,
            cause=self._way_out.cause,
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
            error=self._way_out.error,
        )

    def _spin(self) -> None:
        self._grid = TickGrid(self._clock.now_s() + self._period_s, self._period_s)
        periods, ended = 1, False
        while not ended:
            ended = self._safe_tick(periods * self._period_s)
            periods = self._grid.advance(self._clock.now_s())

    def _safe_tick(self, dt_s: float) -> bool:
        """One tick, when it is due; true if it was the last. What nobody else catches trips the guard."""
        stopping = self._guard.tripped is not None
        try:
            self._clock.sleep_until(self._grid.due_s)
            return self._tick(dt_s)
        except (Exception, SystemExit, KeyboardInterrupt) as error:  # sys.exit() must not drop the arm
            self._way_out.fail("the loop", error)
            return stopping  # and what fails while the arm is stopped leaves nobody to brake it: torque off

    def _tick(self, dt_s: float) -> bool:
        """One tick, `dt_s` after the one before [s]; true if it was the last."""
        guard = self._guard
        woken = perf_counter()
        now_s = self._clock.now_s()
        self._way_out.heed_requests()
        measurement = self._read(now_s)
        read = perf_counter()
        guard.watch(measurement, self._reference_rad)
        watched = perf_counter()
        output = self._stopped_output if guard.tripped else self._step(measurement, dt_s)
        stepped = perf_counter()
        measurement = self._unless_held_up(measurement)
        command = guard.limit(output.command, measurement, dt_s)
        limited = perf_counter()
        sent_nm = self._write(command, now_s)
        written = perf_counter()

        tripped = guard.tripped is not None
        if tripped:
            self._way_out.note_trip()
            output = output._replace(phase=Phase.STOPPED)  # also where the guard refused what the task wanted
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
        record = tick_record(self._grid.index, measurement, output, sent_nm, tripped, estimates, durations)
        self._journal.tick(measurement.time_s, record, output.events)
        self._reference_rad = None if tripped else output.reference_position_rad
        self._ticks += 1
        self._timing.add(durations)
        self._log_s = perf_counter() - observed
        return guard.finished if tripped else output.done

    def _read(self, now_s: float) -> Measurement:
        """This tick's measurement; if reading fails, the last one, marked as the old one that it is."""
        try:
            self._measurement = self._robot.read(now_s + READ_SHARE * self._period_s)
        except Exception as error:
            self._way_out.fail("reading the robot", error)
            stale = Status.STALE
            self._measurement = self._measurement._replace(
                time_s=now_s, encoder_status=stale, torque_status=stale, force_status=stale
            )
        return self._measurement

    def _step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        try:
            return checked_output(self._task.step(measurement, dt_s), self._joints)
        except (Exception, SystemExit, KeyboardInterrupt) as error:  # sys.exit() must not drop the arm
            self._way_out.fail("the task", error)
            return self._stopped_output

    def _unless_held_up(self, measurement: Measurement) -> Measurement:
        """The measurement; dated now, and so too old to act on, where the program was held up since then."""
        held_s = (now_s := self._clock.now_s()) - measurement.time_s
        if held_s <= self._guard.longest_hold_up_s:
            return measurement
        self._guard.trip(f"the program was held up for {held_s:.3g} s within a tick")
        return measurement._replace(time_s=now_s)

    def _write(self, command: Command, now_s: float) -> FloatArray:
        """Send a command; returns what was sent, NaN if nothing was."""
        try:
            return self._robot.write(command, now_s + self._period_s).joint_torque_nm
        except Exception as error:
            self._unsent += 1
            self._way_out.fail("commanding the robot", error)
            return self._unknown

    def _deactivate(self) -> None:
        try:
            self._robot.deactivate()
        except Exception as error:
            self._deactivation_error = one_line(error)
            self._way_out.fail("switching the torque off", error)
