"""Calibrations of the shipped follower in simulated worlds with hidden effects."""

from datetime import UTC, datetime
from pathlib import Path

from palpate.calibration.arm_fit import ArmFit
from palpate.calibration.encoder import EncoderFit
from palpate.calibration.force import ForceFit
from palpate.robot_io.calibration.file import Calibration
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.session import Session
from palpate.runs.calibration import CalibrationJob
from palpate.runs.calibration_file import make_calibration
from palpate.runs.robots import find_robot
from palpate.sim_backend.scenario import load_scenario

NOW = datetime(2026, 11, 20, 8, tzinfo=UTC)
FOLLOWER = find_robot("follower")


def job_in(
    folder: Path, kind: str, hidden: list[dict], seed: int = 1, robot: RobotFile = FOLLOWER
) -> CalibrationJob:
    """A calibration of the follower, with its session in `folder`."""
    scenario = load_scenario({"seed": seed, "hidden": hidden})
    return CalibrationJob(robot, folder / f"{kind}-{seed}.mcap", kind, scenario=scenario)


def opened(job: CalibrationJob) -> Session:
    return Session.open(job.session)


def made(job: CalibrationJob, fit: ArmFit | EncoderFit | ForceFit) -> Calibration:
    return make_calibration(job.kind, fit, job.robot_file, job.session, 365.0)


def in_joints(effect: str, **parameters) -> list[dict]:
    """One entry for each joint; every parameter is a sequence of three."""
    return [
        {
            "effect": effect,
            "joint": joint + 1,
            **{name: float(values[joint]) for name, values in parameters.items()},
        }
        for joint in range(3)
    ]
