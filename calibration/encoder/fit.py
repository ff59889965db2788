"""Zeros of the joints: known positions minus what the encoders show there."""

from dataclasses import dataclass

import numpy as np

from calibration.encoder.stops import EVENT
from calibration.statistics import few_sample_factor
from robot_io.errors import InputError
from robot_io.session import Samples, Session
from robot_io.types import FloatArray, Status

_ROUNDING_RAD = 1e-12  # of a mean of equal numbers
_UNIFORM = np.sqrt(12.0)  # resolution over the standard deviation that it alone gives


@dataclass(frozen=True)
class EncoderFit:
    """Zeros of n joints."""

    offset_rad: FloatArray  # to be added to what the encoders show, shape (n,) [rad]
    std_rad: FloatArray  # standard uncertainties, shape (n,) [rad]
    shown_rad: tuple[FloatArray, ...]  # one mean for every touch of every joint, or one for the pose [rad]
    repeatability_rad: FloatArray  # standard deviation of the touches, shape (n,); 0 for a pose [rad]


def fit_stops(session: Session, joint_count: int, stop_std_rad: float) -> EncoderFit:
    """Fit zeros to touches of hard stops, as `StopTask` logs them.

    Args:
        session: with the touches.
        joint_count: number of joints n.
        stop_std_rad: standard uncertainty of the stops' positions [rad].

    Returns:
        The zeros.

    Raises:
        InputError: a joint's stop was not touched at least twice.
    """
    ticks = _fresh(session.samples("tick"))
    position = ticks.vector("joint_position_rad")
    shown: list[list[float]] = [[] for _ in range(joint_count)]
    known = np.full(joint_count, np.nan)
    for event in session.events:
        if event.kind == EVENT and event.data:
            joint = int(event.data["joint"])
            known[joint] = float(event.data["stop_rad"])
            shown[joint].append(float(position[ticks["run"] == event.data["run"], joint].mean()))
    missing = [joint + 1 for joint, touches in enumerate(shown) if len(touches) < 2]
    if missing:
        raise InputError(f"{session.path}: joint {missing[0]} was not held against its stop at least twice")
    means = np.array([np.mean(touches) for touches in shown])
    scatter = np.array([np.std(touches, ddof=1) for touches in shown])
    scatter[scatter < _ROUNDING_RAD] = 0.0
    counts = np.array([len(touches) for touches in shown])
    errors = np.array([few_sample_factor(count - 1) for count in counts]) * scatter / np.sqrt(counts)
    resolution = _resolution(session.samples("tick"))
    std = np.sqrt(errors**2 + (resolution / _UNIFORM) ** 2 + stop_std_rad**2)
    return EncoderFit(known - means, std, tuple(np.array(t) for t in shown), scatter)


def fit_pose(session: Session, pose_rad: FloatArray, pose_std_rad: float) -> EncoderFit:
    """Fit zeros to a pose in which the arm was held.

    Args:
        session: in which the arm stands still.
        pose_rad: shape (n,) [rad].
        pose_std_rad: standard uncertainty of each joint [rad].

    Returns:
        The zeros.

    Raises:
        InputError: the session holds no samples, or the arm moved.
    """
    position = _fresh(session.samples("tick")).vector("joint_position_rad")
    if not len(position):
        raise InputError(f"{session.path}: no fresh encoder samples in it")
    resolution = _resolution(session.samples("tick"))
    moved = np.ptp(position, axis=0)
    if np.any(moved > max(10 * resolution, 2e-3)):
        joint = int(np.argmax(moved))
        raise InputError(
            f"joint {joint + 1} moved by {moved[joint]:.2g} rad: the arm must stand still in the pose"
        )
    means = position.mean(axis=0)
    half_ranges = 0.5 * moved / np.sqrt(3.0)
    std = np.sqrt(half_ranges**2 + (resolution / _UNIFORM) ** 2 + pose_std_rad**2)
    return EncoderFit(pose_rad - means, std, tuple(means[:, None]), np.zeros(len(means)))


def _fresh(ticks: Samples) -> Samples:
    return ticks.select(ticks["encoder_status"] == Status.OK)


def _resolution(ticks: Samples) -> float:
    """The encoders' steps as the data show them: the smallest change from tick to tick [rad]; 0 if none."""
    changes = np.abs(np.diff(ticks.vector("joint_position_rad"), axis=0)).ravel()
    changes = changes[changes > 1e-12]
    return float(changes.min()) if len(changes) else 0.0
