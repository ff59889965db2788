"""Gains, offsets and friction of the drives, and the base's tilt, from one motion in free air.

    gain_j m_j(t) + offset_j = (I_j + G_j g(pitch, roll))(t - delay) + coulomb_j sign(v_j) + viscous_j v_j

I and G are of `calibration.arm.model`, m is what the drives measure. It carries the noise, so it is what is
fitted, with 1 / gain_j on the right. The amplitude of the weight's torque gives the gain and its phase the
tilt. The delay between the samples of motion and torque is fitted as well: left alone it passes for viscous
friction. Samples near standstill, where friction is anything up to its limit, are left out.

Gauss-Newton, each joint weighted with its own residual; the covariance allows for autocorrelated residuals
(estimation.statistics). Friction: Armstrong-Helouvry et al., Automatica 30 (1994).
"""

from dataclasses import dataclass, fields

import numpy as np

from calibration.arm.model import GravityBodies, fall, fall_slopes
from estimation.data.tick_channels import joint_channels
from estimation.statistics.serial_covariance import sum_covariance
from robot_io.errors import InputError
from robot_io.session import Samples
from robot_io.types import BoolArray, FloatArray, IntArray

STANDSTILL_RAD_S = 0.03
_EDGE = 30  # samples at either end, where derivatives are one-sided
BLOCK = 50  # samples whose mean is one observation
_FEWEST = 500  # samples of a motion
_FEWEST_BLOCKS = 50  # of each joint, in motion
_STEPS = 12
_CONVERGED = 1e-10
_UNFELT = 1e-3  # of the larger one: a tilt whose torque is less than that is not felt
_FEWEST_LOADED = 1e-9


@dataclass(frozen=True)
class ArmFit:
    """What a motion says; standard uncertainties beside the values, arrays of shape (n,).

    Attributes:
        gain: true over measured torque [-].
        offset_nm: true torque where the measured one is 0 [N m].
        command_offset_nm: true torque where the commanded one is 0 [N m].
        coulomb_nm: dry friction [N m].
        viscous_nms_rad: viscous friction [N m s/rad].
        delay_s: of the torque samples behind the motion's, and its standard uncertainty, shape (2,) [s].
        tilt_rad: pitch and roll, shape (2,) [rad]; NaN where the arm does not feel it.
        residual_nm: measured less fitted torque, NaN where a sample was left out, shape (m, n) [N m].
        position_rad: shape (m, n) [rad].
        velocity_rad_s: shape (m, n) [rad/s].
    """

    gain: FloatArray
    gain_std: FloatArray
    offset_nm: FloatArray
    offset_std_nm: FloatArray
    command_offset_nm: FloatArray
    command_offset_std_nm: FloatArray
    coulomb_nm: FloatArray
    coulomb_std_nm: FloatArray
    viscous_nms_rad: FloatArray
    viscous_std_nms_rad: FloatArray
    delay_s: FloatArray
    tilt_rad: FloatArray
    tilt_std_rad: FloatArray
    residual_nm: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray


@dataclass(frozen=True)
class ArmMotion:
    """Motion and torques at the times of the torque samples (m,), each of shape (m, n), SI units."""

    time_s: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray
    measured_nm: FloatArray
    sent_nm: FloatArray


def motion_of(ticks: Samples) -> ArmMotion:
    """The part of a session in which the path was followed.

    Raises:
        InputError: there is none.
    """
    excited = ticks.select(ticks["run"] == 0)
    channels = joint_channels(excited)
    if not channels or len(channels[0]) < _FEWEST:
        raise InputError(
            "the session holds too little motion to calibrate from: its calibration was interrupted"
        )
    context, inner = channels[0].context, slice(_EDGE, -_EDGE)
    sent = _at_rows(excited, channels[0].time_s)
    return ArmMotion(
        channels[0].time_s[inner],
        context["joint_position"][inner],
        context["joint_velocity"][inner],
        context["joint_acceleration"][inner],
        np.column_stack([channel.effort for channel in channels])[inner],
        sent[inner],
    )


def fit_arm(motion: ArmMotion, bodies: GravityBodies) -> ArmFit:
    """Fit the model to a motion.

    Raises:
        InputError: a joint hardly moved, or its load does not change, so that its gain cannot be told.
    """
    inertial, gravity = bodies.parts(motion.position_rad, motion.velocity_rad_s, motion.acceleration_rad_s2)
    moving = _means(_well_moving(motion.velocity_rad_s).astype(np.float64)) == 1.0
    inertial, gravity = _means(inertial), _means(gravity)
    motion = ArmMotion(*(_means(getattr(motion, field.name)) for field in fields(motion)))
    _check(moving, inertial + gravity @ fall(np.zeros(2)))
    felt = _felt(gravity)
    solver = _Solver(motion, inertial, gravity, moving, felt)
    values, covariance = solver.solve()
    return _unpacked(solver, values, covariance, motion)


class _Solver:
    """Gauss-Newton over (1/gain, coulomb/gain, viscous/gain, offset/gain) of each joint, and the tilt."""

    def __init__(
        self, motion: ArmMotion, inertial: FloatArray, gravity: FloatArray, moving: BoolArray, felt: BoolArray
    ) -> None:
        self.motion, self.moving, self.felt = motion, moving, felt
        self._inertial, self._gravity = inertial, gravity
        self.joints = inertial.shape[1]
        self.delay = 4 * self.joints  # index of the delay; the tilts follow

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Values and covariance, the tilts that are not felt left out."""
        values = np.zeros(self.delay + 1 + int(self.felt.sum()))
        values[: self.delay : 4] = 1.0
        weight = np.ones(self.joints)
        for _ in range(_STEPS):
            columns, residual, joint = self._linearised(values)
            weight = np.array([1.0 / residual[joint == j].std() for j in range(self.joints)])
            w = weight[joint]
            step = np.linalg.lstsq(columns * w[:, None], residual * w, rcond=None)[0]
            values = values + step
            if np.abs(step).max() < _CONVERGED:
                break
        columns, residual, joint = self._linearised(values)
        w = weight[joint]
        inverse = np.linalg.inv((columns * w[:, None] ** 2).T @ columns)
        scores = columns * (residual * w**2)[:, None]
        middle = sum_covariance(scores, joint).matrix
        return values, inverse @ middle @ inverse

    def tilt(self, values: FloatArray) -> FloatArray:
        """Pitch and roll, 0 where they are not felt."""
        tilt = np.zeros(2)
        tilt[self.felt] = values[self.delay + 1 :]
        return tilt

    def known_nm(self, values: FloatArray) -> FloatArray:
        """The rigid body's torques with this tilt and delay, shape (m, n)."""
        known, rate = self._known_and_rate(values)
        return np.asarray(known - values[self.delay] * rate)

    def _known_and_rate(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        known = np.asarray(self._inertial + self._gravity @ fall(self.tilt(values)))
        return known, np.gradient(known, self.motion.time_s, axis=0)

    def _linearised(self, values: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Columns (k, p), residuals (k,) and joint numbers (k,) of all samples that count."""
        known, rate = self._known_and_rate(values)
        known -= values[self.delay] * rate
        slopes = self._gravity @ fall_slopes(self.tilt(values))[:, self.felt]
        blocks, residuals, joints = [], [], []
        for j in range(self.joints):
            rows, (s, c, b, o) = self.moving[:, j], values[4 * j : 4 * j + 4]
            speed = self.motion.velocity_rad_s[rows, j]
            own = np.column_stack([known[rows, j], np.sign(speed), speed, -np.ones(len(speed))])
            block = np.zeros((len(speed), len(values)))
            block[:, 4 * j : 4 * j + 4] = own
            block[:, self.delay] = -s * rate[rows, j]
            block[:, self.delay + 1 :] = s * slopes[rows, j]
            blocks.append(block)
            residuals.append(self.motion.measured_nm[rows, j] - own @ np.array([s, c, b, o]))
            joints.append(np.full(len(speed), j))
        return np.concatenate(blocks), np.concatenate(residuals), np.concatenate(joints)


def _unpacked(solver: _Solver, values: FloatArray, covariance: FloatArray, motion: ArmMotion) -> ArmFit:
    """Gain, offset and friction out of their ratios, with uncertainties to the first order."""
    n = solver.joints
    s, c, b, o = (values[k : 4 * n : 4] for k in range(4))
    gain = 1.0 / s
    found, errors = {}, {}
    for name, k, ratio in (("coulomb", 1, c), ("viscous", 2, b), ("offset", 3, o)):
        slopes = np.zeros((n, len(values)))
        rows = np.arange(n)
        slopes[rows, 4 * rows + k] = gain
        slopes[rows, 4 * rows] = -ratio * gain**2
        found[name], errors[name] = (
            gain * ratio,
            np.sqrt(np.einsum("ip,pq,iq->i", slopes, covariance, slopes)),
        )
    gain_std = gain**2 * np.sqrt(np.diag(covariance)[: 4 * n : 4])
    tilt, tilt_std = np.full(2, np.nan), np.full(2, np.nan)
    tilt[solver.felt], tilt_std[solver.felt] = values[4 * n + 1 :], np.sqrt(np.diag(covariance)[4 * n + 1 :])
    shift, shift_std = _mean_and_error(motion.measured_nm - motion.sent_nm)
    residual = motion.measured_nm - _predicted(solver, values)
    return ArmFit(
        gain=gain,
        gain_std=gain_std,
        offset_nm=found["offset"],
        offset_std_nm=errors["offset"],
        command_offset_nm=found["offset"] + gain * shift,
        command_offset_std_nm=np.hypot(errors["offset"], gain * shift_std),
        coulomb_nm=found["coulomb"],
        coulomb_std_nm=errors["coulomb"],
        viscous_nms_rad=found["viscous"],
        viscous_std_nms_rad=errors["viscous"],
        delay_s=np.array([values[4 * n], np.sqrt(covariance[4 * n, 4 * n])]),
        tilt_rad=tilt,
        tilt_std_rad=tilt_std,
        residual_nm=np.where(solver.moving, residual, np.nan),
        position_rad=motion.position_rad,
        velocity_rad_s=motion.velocity_rad_s,
    )


def _predicted(solver: _Solver, values: FloatArray) -> FloatArray:
    s, c, b, o = (values[k : 4 * solver.joints : 4] for k in range(4))
    speed = solver.motion.velocity_rad_s
    return np.asarray(s * solver.known_nm(values) + c * np.sign(speed) + b * speed - o)


def _mean_and_error(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of the columns, and their standard errors with correlated rows."""
    mean = values.mean(axis=0)
    return mean, np.sqrt(np.diag(sum_covariance(values - mean).matrix)) / len(values)


def _means(values: FloatArray) -> FloatArray:
    """Means of blocks of `BLOCK` samples, along the first axis.

    Both sides of a linear equation may be filtered alike. It takes away the controller's answer to the
    encoders' noise, which is in the measured torque and, smoothed differently, in the acceleration.
    """
    count = len(values) // BLOCK
    return np.asarray(values[: count * BLOCK].reshape(count, BLOCK, *values.shape[1:]).mean(axis=1))


def _well_moving(velocity_rad_s: FloatArray) -> BoolArray:
    """Samples of each joint away from standstill, also by time: derivatives smear friction's jump there."""
    still = np.abs(velocity_rad_s) <= STANDSTILL_RAD_S
    near = np.ones(2 * _EDGE + 1)
    return np.column_stack([np.convolve(joint, near, mode="same") < 0.5 for joint in still.T])


def _felt(gravity: FloatArray) -> BoolArray:
    """Which of pitch and roll change the torques of a level arm enough to be told."""
    size = np.linalg.norm((gravity @ fall_slopes(np.zeros(2))).reshape(-1, 2), axis=0)
    return np.asarray(size > _UNFELT * max(float(size.max()), _FEWEST_LOADED))


def _check(moving: BoolArray, torque_nm: FloatArray) -> None:
    for joint, (count, spread) in enumerate(
        zip(moving.sum(axis=0), np.ptp(torque_nm, axis=0), strict=True), 1
    ):
        if count < _FEWEST_BLOCKS:
            raise InputError(
                f"joint {joint} hardly moves: only {count} blocks of {BLOCK} samples are faster than "
                f"{STANDSTILL_RAD_S} rad/s"
            )
        if spread < _FEWEST_LOADED:
            raise InputError(
                f"joint {joint} carries the same load everywhere: its torque gain cannot be told"
            )


def _at_rows(ticks: Samples, torque_at_s: FloatArray) -> FloatArray:
    """What had been sent when each torque was sampled, shape (m, n) [N m]."""
    before = np.searchsorted(ticks["time_s"], torque_at_s, side="right") - 1
    return np.asarray(ticks.vector("torque_sent_nm")[np.maximum(before, 0)])
