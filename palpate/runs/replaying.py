"""Puts a replay together: the references of a session, and the arm and world that repeat them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from control.loop.result import LoopResult
from control.loop.task import NO_RUN
from control.loop.tick_record import STREAM_NAME
from control.probing.replay import References, ReplayTask
from palpate.runs.probing import NOBODY, Watcher, run_guarded
from palpate.runs.session import SOURCE, ArmJob
from robot_io.calibration import load_calibrations
from robot_io.errors import InputError
from robot_io.session import Session

REPLAY_OF = "replay_of"  # key of the session that was repeated, in the session's metadata
_STILL_RAD_S = 1e-3  # slower references stand
_FARTHEST_M = 0.005  # that the tip may be elsewhere, with this arm in the recorded postures


@dataclass(frozen=True)
class ReplayJob(ArmJob):
    """What is to be repeated, with which arm, and where to."""

    recorded: Session


def references_of(session: Session) -> References:
    """What the arm of a session was to do, up to where it last stood between runs: there it can be let go.

    Raises:
        InputError: it is no probing, or holds no whole run.
    """
    if STREAM_NAME not in session.stream_names:
        raise InputError(f"{session.path}: no arm made it, so there is no motion to repeat")
    ticks = session.samples(STREAM_NAME)
    speed_rad_s = np.abs(ticks.vector("reference_velocity_rad_s")).max(axis=1)
    aimed = np.isfinite(ticks.vector("reference_position_rad")).all(axis=1) & np.isfinite(speed_rad_s)
    told = len(aimed) if aimed.all() else int(np.argmin(aimed))  # nothing is aimed at once it was stopped
    stands = (ticks["run"][:told] == NO_RUN) & (speed_rad_s[:told] < _STILL_RAD_S)
    count = int(np.flatnonzero(stands)[-1]) + 1 if stands.any() else 0
    if not (ticks["run"][:count] != NO_RUN).any():
        raise InputError(f"{session.path}: holds no whole run, after which the arm stood; nothing to repeat")
    first = slice(0, count)
    return References(
        ticks["time_s"][first] - ticks["time_s"][0],
        ticks.vector("reference_position_rad")[first],
        ticks.vector("reference_velocity_rad_s")[first],
        ticks["run"][first].astype(np.int64),
        ticks["phase"][first].astype(np.int64),
        ticks["press_direction_world"][first],
    )


def run_replay(
    job: ReplayJob, references: References, watcher: Watcher = NOBODY
) -> tuple[LoopResult, Path | None]:
    """Repeat the references, and write a session of it; returns the sealed answer of a hidden world too.

    Raises:
        InputError: they are of another arm, or what they need does not fit each other; nothing has moved.
    """
    calibrations = load_calibrations(job.robot_file, emulated=job.wired)
    body = RigidBody.of_robot(job.robot_file, calibrations)
    task = ReplayTask(body, gains_of(job.robot_file), references)
    _check_arm(body, job.recorded)
    extra = {REPLAY_OF: f"{job.recorded.path.name}, made {job.recorded.metadata.created_utc}"}
    if SOURCE in job.recorded.metadata.extra:
        extra[REPLAY_OF] += f", {job.recorded.metadata.extra[SOURCE]}"
    return run_guarded(job, task, calibrations, extra, watcher.observe, watcher)


def _check_arm(body: RigidBody, recorded: Session) -> None:
    """Refuse an arm whose tip would be elsewhere in the recorded postures."""
    ticks = recorded.samples(STREAM_NAME)
    rows = np.linspace(0, len(ticks) - 1, 20).astype(int)
    there_m = ticks.vector("tip_position_world_m")[rows]
    here_m = np.array([body.tip_pose(q)[0] for q in ticks.vector("joint_position_rad")[rows]])
    off_m = float(np.nanmax(np.linalg.norm(here_m - there_m, axis=1)))
    if off_m > _FARTHEST_M:
        raise InputError(
            f"{recorded.path}: was made by another arm: in its postures this one's tip is up to "
            f"{1e3 * off_m:.0f} mm elsewhere. Name the arm with --robot"
        )
