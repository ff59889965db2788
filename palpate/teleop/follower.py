"""The follower: an arm that holds still, probes what the leader asks for, and says what it found.

The control loop runs in the main thread, as for `palpate probe`; a second thread talks to the leader, and
processes of their own estimate. Neither can hold the loop up, and only the queue of targets leads into it.
"""

from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
import yaml

from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from control.loop.realtime import realtime
from control.loop.result import LoopResult
from control.probing.plan import ProbingPlan
from control.probing.sites import check_against_guard
from control.probing.task import ProbingTask
from control.teleop.follower_task import FollowerTask, OnSilence, plan_for
from control.teleop.messaging import LINK_STREAM
from palpate.runs.probing import PLAN
from palpate.runs.session import ArmJob, arm_session, checked_body
from palpate.teleop.follower_messaging import FollowerMessaging, Say
from palpate.teleop.follower_observer import Observer
from robot_io.calibration import load_calibrations
from robot_io.guard import Guard
from robot_io.link import Line, LineSettings, Target, TargetState, short_number


@dataclass(frozen=True)
class FollowerJob(ArmJob):
    """Which arm follows, how it probes, and how it is linked."""

    plan: ProbingPlan  # how each target is probed; targets of its own it has none
    _: KW_ONLY
    link: LineSettings = field(default_factory=LineSettings)
    on_silence: OnSilence = OnSilence.FINISH
    diagnose: bool = True


@dataclass(frozen=True)
class FollowerOutcome:
    """How it ended."""

    loop: LoopResult
    states: dict[int, TargetState]  # what became of each target, by its leader's count
    estimates: int  # how many were made
    talk_error: str  # why the link was given up; empty if it was not


def run_follower(job: FollowerJob, say: Say) -> FollowerOutcome:
    """Follow until the leader has ended, somebody stops it, or the guard trips; the session is whole then.

    Raises:
        InputError: robot file, plan, link and scenario do not fit each other; nothing has moved.
    """
    robot_file, rate_hz = job.robot_file, job.robot_file.control_rate_hz
    check_against_guard(job.plan, robot_file)
    calibrations = load_calibrations(robot_file, emulated=job.wired)
    guard_body, body = checked_body(robot_file, calibrations), RigidBody.of_robot(robot_file, calibrations)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count, guard_body.gravity)
    plan_text = yaml.safe_dump(job.plan.model_dump(mode="json"), sort_keys=False)

    def probing(target: Target) -> ProbingTask:
        return ProbingTask.from_robot_file(robot_file, plan_for(target, job.plan), calibrations, body)

    with ExitStack() as stack:
        arm = stack.enter_context(arm_session(job, calibrations, {PLAN: plan_text}, streams=(LINK_STREAM,)))
        line = stack.enter_context(Line("follower", job.link, arm.clock))
        messaging = FollowerMessaging(line, arm.clock, say, diagnose=job.diagnose)
        stack.callback(messaging.close)
        axis = np.array(robot_file.sensor_axis_tip)
        task = FollowerTask(
            body, axis, gains_of(robot_file), messaging.queue, probing, messaging.settled, job.on_silence
        )
        if not job.simulated:
            stack.enter_context(realtime())
        observer = Observer(messaging, arm.log, robot_file.joint_count, len(list(job.plan.runs())))
        messaging.start()
        if line.is_open_here:
            say("no --key: any program of this machine may say where the arm presses; on 127.0.0.1 alone")
        say("waiting for a leader; Ctrl-C brings the arm to rest")
        result = arm.run(task, guard, rate_hz, observer.observe)
        messaging.farewell(result.cause)
    states = {short_number(number): state for number, state in messaging.queue.states().items()}
    return FollowerOutcome(result, states, messaging.estimates, messaging.error)
