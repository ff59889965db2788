"""Fit drives, friction and tilt of the whole arm to its torques in an exciting motion.

    torque_j = I_j(q, v, a) + G_j(q) g

I is the inertial part, and G the torque per component of the gravitational acceleration g in the base's axes,
in which the torque is linear. The masses of the URDF are assumed to be exact.

The fit finds gains, offsets and friction of the drives, and the base's tilt, from one motion in free air.

    gain_j m_j(t) + offset_j = (I_j + G_j g(pitch, roll))(t - delay) + coulomb_j sign(v_j) + viscous_j v_j

I and G come from the model, and m is the torque measured by the drives. Because m is noisy, m is the
regressand, with 1 / gain_j on the right-hand side. The amplitude of the weight's torque gives the gain and
its phase the tilt. The delay between the samples of motion and torque is fitted too, because an unmodeled
delay resembles viscous friction. Samples near standstill, where friction takes any value up to its limit, are
left out.

Gauss-Newton, each joint weighted with its own residual; the covariance allows for autocorrelated residuals
(palpate.estimation.statistics). Friction: Armstrong-Helouvry et al., Automatica 30 (1994).
"""

from dataclasses import dataclass, fields

import numpy as np

from palpate.calibration.standstill import MAX_REL_STD, UncertainValue
from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.data.tick_channels import joint_channels
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.noise import sum_covariance
from palpate.estimation.statistics.uncertainty import sandwich
from palpate.robot_io.calibration.applied import gravity_base_m_s2
from palpate.robot_io.calibration.file import USABLE_GAINS
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Samples
from palpate.robot_io.types import BoolArray, FloatArray, IntArray


def _gravity_direction(tilt_rad: FloatArray) -> FloatArray:
    """Compute gravity in the base's axes, shape (3,) [m/s^2], from pitch and roll [rad]."""
    return np.array(gravity_base_m_s2(float(tilt_rad[0]), float(tilt_rad[1])))


def _gravity_slopes(tilt_rad: FloatArray) -> FloatArray:
    """Compute the derivatives of `_gravity_direction` by both angles, shape (3, 2) [m/s^2 per rad]."""
    step = 1e-6
    return np.column_stack(
        [
            (_gravity_direction(tilt_rad + step * turn) - _gravity_direction(tilt_rad - step * turn))
            / (2 * step)
            for turn in np.eye(2)
        ]
    )


def design_matrix(body: RigidBody, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Compute the linearized model, shape (m n, 4 n + 2): gain, Coulomb, viscous, offset each; tilt.

    Args:
        body: model of the arm.
        q: joint positions, shape (m, n) [rad].
        v: joint velocities, shape (m, n) [rad/s].
        a: joint accelerations, shape (m, n) [rad/s^2].
    """
    inertial, gravity = body.inertial_and_gravity_torques(q, v, a)
    level = np.zeros(2)
    torque = inertial + gravity @ _gravity_direction(level)
    slopes = gravity @ _gravity_slopes(level)
    count, joints = q.shape
    columns = np.zeros((joints, count, 4 * joints + 2))
    for joint in range(joints):
        block = np.column_stack([torque[:, joint], np.sign(v[:, joint]), v[:, joint], -np.ones(count)])
        columns[joint, :, 4 * joint : 4 * joint + 4] = block
        columns[joint, :, -2:] = slopes[:, joint]
    return columns.reshape(joints * count, -1)


STANDSTILL_RAD_S = 0.03
_EDGE = 30  # samples at either end, where derivatives are one-sided
BLOCK = 50  # samples whose mean is one observation
_MIN_SAMPLES = 500  # samples of a motion
_MIN_BLOCKS = 50  # of each joint, in motion
_MAX_STEPS = 12
_CONVERGED = 1e-10
_MIN_TILT_EFFECT = 1e-3  # least effect of an identifiable tilt on the torques, relative to the larger effect
_MIN_TORQUE_NM = 1e-9  # least range of a joint's torque, and least effect of a tilt


PLAUSIBLE_GAINS = (0.5, 2.0)
_MAX_REL_RESIDUAL = 0.3  # largest residual (rms) of a plausible fit, as a share of the measured torque's
_SATURATED_SHARE = 0.05  # least range of the model at an extreme reading of a saturated signal, as a share

UncertainArray = UncertainValue[FloatArray]


@dataclass(frozen=True)
class ArmFit:
    """Parameters of each joint, shape (n,), of the base, and residuals of the samples, shape (m, n)."""

    gain: UncertainArray  # true over measured torque [-]
    offset_nm: UncertainArray  # true torque where the measured one is 0 [N m]
    command_offset_nm: UncertainArray  # true torque where the commanded one is 0 [N m]
    coulomb_nm: UncertainArray  # dry friction [N m]
    viscous_nms_rad: UncertainArray  # viscous friction [N m s/rad]
    delay_s: UncertainValue[float]  # delay of the torque samples relative to the motion samples [s]
    tilt_rad: UncertainArray  # pitch and roll, shape (2,) [rad]; NaN if not identifiable
    residual_nm: FloatArray  # measured minus fitted torque, NaN for excluded samples [N m]
    measured_nm: FloatArray  # means of blocks of samples, like all arrays (m, n) [N m]
    position_rad: FloatArray
    velocity_rad_s: FloatArray


@dataclass(frozen=True)
class ArmMotion:
    """Motion and torques, shape (m, n) each, at the times (m,) of the torque samples; SI units."""

    time_s: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    acceleration_rad_s2: FloatArray
    measured_nm: FloatArray
    sent_nm: FloatArray


def motion_of(ticks: Samples) -> ArmMotion:
    """Extract the part of a session in which the arm followed the path, without its first and last samples.

    Args:
        ticks: samples of the stream "tick"; those of run 0 belong to the path.

    Raises:
        InputError: there is too little motion, as after an interruption.
    """
    excited = ticks.select(ticks["run"] == 0)
    channels = joint_channels(excited)
    if not channels or len(channels[0]) < _MIN_SAMPLES:
        raise InputError("too little motion to calibrate from, because the calibration was interrupted")
    context, inner = channels[0].context, slice(_EDGE, -_EDGE)
    sent_rows = np.searchsorted(excited["time_s"], channels[0].time_s, side="right") - 1
    sent = excited.vector("torque_sent_nm")[np.maximum(sent_rows, 0)]
    return ArmMotion(
        channels[0].time_s[inner],
        context["joint_position"][inner],
        context["joint_velocity"][inner],
        context["joint_acceleration"][inner],
        np.column_stack([channel.effort for channel in channels])[inner],
        sent[inner],
    )


def fit_arm(motion: ArmMotion, body: RigidBody) -> ArmFit:
    """Fit drives, friction, delay and tilt to a motion.

    Args:
        motion: motion and torques.
        body: model of the arm.

    Raises:
        InputError: a joint hardly moved, or its load does not change, so that its gain is not identifiable.
    """
    inertial, gravity = body.inertial_and_gravity_torques(
        motion.position_rad, motion.velocity_rad_s, motion.acceleration_rad_s2
    )
    # Samples near standstill and their neighbors are left out: derivatives smear the jump of friction.
    is_slow = np.abs(motion.velocity_rad_s) <= STANDSTILL_RAD_S
    window = np.ones(2 * _EDGE + 1)
    is_moving = np.column_stack([np.convolve(joint, window, mode="same") < 0.5 for joint in is_slow.T])
    moving = _means(is_moving.astype(np.float64)) == 1.0
    inertial, gravity = _means(inertial), _means(gravity)
    motion = ArmMotion(*(_means(getattr(motion, field.name)) for field in fields(motion)))
    torque_nm = inertial + gravity @ _gravity_direction(np.zeros(2))
    for joint, (count, spread) in enumerate(
        zip(moving.sum(axis=0), np.ptp(torque_nm, axis=0), strict=True), 1
    ):
        if count < _MIN_BLOCKS:
            raise InputError(
                f"joint {joint} hardly moves: only {count} blocks of {BLOCK} samples are faster than "
                f"{STANDSTILL_RAD_S} rad/s"
            )
        measured_nm = motion.measured_nm[:, joint - 1]
        if np.ptp(measured_nm) < _MIN_TORQUE_NM:
            raise InputError(
                f"joint {joint}: its measured torque is always {measured_nm[0]:.3g} N m, so the drive "
                "does not report it; check the section `torque` of the robot file"
            )
        if spread < _MIN_TORQUE_NM:
            raise InputError(
                f"joint {joint} carries the same load everywhere, so its torque gain cannot be identified"
            )
    tilt_norms = np.linalg.norm((gravity @ _gravity_slopes(np.zeros(2))).reshape(-1, 2), axis=0)
    axes = np.asarray(tilt_norms > _MIN_TILT_EFFECT * max(float(tilt_norms.max()), _MIN_TORQUE_NM))
    solver = _Solver(motion, inertial, gravity, moving, axes)
    return _arm_fit(solver, *solver.solve())


def implausible_arm(fit: ArmFit, *, gains_are_applied: bool) -> list[str]:
    """Describe, with joint, value and cause, why a fit should not be applied; empty if it is plausible.

    Args:
        fit: fit of drives and base.
        gains_are_applied: whether the gains are applied, and not only used to find the tilt.

    Raises:
        InputError: a gain that is to be applied cannot be right.
    """
    reasons: list[str] = []
    for joint, gain in enumerate(fit.gain.value.tolist()):
        std_err = float(fit.gain.std_err[joint]) if gains_are_applied else 0.0
        found = [_implausible_gain(gain, std_err)]
        is_moving = np.isfinite(fit.residual_nm[:, joint])
        measured_nm, residual_nm = (x[is_moving, joint] for x in (fit.measured_nm, fit.residual_nm))
        fitted_nm, rms_nm = measured_nm - residual_nm, float(np.sqrt(np.mean(residual_nm**2)))
        if rms_nm > _MAX_REL_RESIDUAL * measured_nm.std():
            found.append(
                f"the residual of its torque is {rms_nm:.2g} N m (rms), "
                f"{100 * rms_nm / measured_nm.std():.2g} % of its variation (at most "
                f"{100 * _MAX_REL_RESIDUAL:g} % is plausible); either two joints' torques are swapped, or "
                "the URDF describes another arm"
            )
        for extreme_nm in (measured_nm.min(), measured_nm.max()):
            held_nm = fitted_nm[np.isclose(measured_nm, extreme_nm, rtol=1e-9, atol=0.0)]
            if len(held_nm) > 1 and np.ptp(held_nm) > _SATURATED_SHARE * np.ptp(fitted_nm):
                found.append(
                    f"its measured torque stays at {extreme_nm:.3g} N m while the modeled torque changes by "
                    f"{np.ptp(held_nm):.2g} N m, so the signal is saturated; give it a larger range, or "
                    "reduce limits.torque_nm"
                )
        reasons += [f"joint {joint + 1}: {reason}" for reason in found if reason]
    low, high = USABLE_GAINS
    if gains_are_applied and np.any((fit.gain.value < low) | (fit.gain.value > high)):
        raise InputError(f"{'; '.join(reasons)}; only gains from {low:g} to {high:g} can be applied")
    return reasons


def _implausible_gain(gain: float, std_err: float) -> str:
    low, high = PLAUSIBLE_GAINS
    if gain < 0.0:
        return (
            f"the gain of its torque is {gain:.3g}, so the sign is reversed; correct it in the robot file, "
            "for example with `reversed`"
        )
    if not low <= gain <= high:
        return (
            f"the gain of its torque is {gain:.3g}, outside {low:g} to {high:g}; either the torque constant "
            "or gear ratio in the robot file is wrong, or the torques of two joints are swapped"
        )
    if std_err > MAX_REL_STD * gain:
        return (
            f"the gain of its torque, {gain:.3g}, is known only to ± {200 * std_err / gain:.2g} % (95 % "
            f"interval; at most {200 * MAX_REL_STD:g} % is plausible); check that the torque neither drifts "
            "nor jumps, and that the URDF describes this arm"
        )
    return ""


class _Solver:
    """Gauss-Newton over (1/gain, coulomb/gain, viscous/gain, offset/gain) of each joint, and the tilt."""

    def __init__(
        self, motion: ArmMotion, inertial: FloatArray, gravity: FloatArray, moving: BoolArray, axes: BoolArray
    ) -> None:
        self.motion, self.moving, self.axes = motion, moving, axes  # `axes`: mask of the fitted tilts, (2,)
        self._inertial, self._gravity = inertial, gravity
        self.joints = inertial.shape[1]
        self.delay = 4 * self.joints  # index of the delay; the tilts follow

    def solve(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return values and covariance of the identifiable parameters, and residuals, shape (m, n) [N m]."""
        values = np.zeros(self.delay + 1 + int(self.axes.sum()))
        values[: self.delay : 4] = 1.0
        for _ in range(_MAX_STEPS):
            columns, residual, w, _ = self._linearized(values)
            step = solve(columns, residual, w)
            values = values + step
            if np.abs(step).max() < _CONVERGED:
                break
        columns, residual, w, joint = self._linearized(values)
        residual_nm = np.full(self.moving.shape, np.nan)
        residual_nm.T[self.moving.T] = residual  # one joint after the other
        return values, sandwich(columns, residual * w**2, w**2, joint).matrix, residual_nm

    def _linearized(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return columns (k, p), residuals, weights and joint numbers (k,) of all samples in use."""
        tilt = np.zeros(2)  # 0 where not identifiable
        tilt[self.axes] = values[self.delay + 1 :]
        rigid_nm = self._inertial + self._gravity @ _gravity_direction(tilt)
        rate = np.gradient(rigid_nm, self.motion.time_s, axis=0)
        rigid_nm = rigid_nm - values[self.delay] * rate
        slopes = self._gravity @ _gravity_slopes(tilt)[:, self.axes]
        blocks, residuals, weights, joints = [], [], [], []
        for j in range(self.joints):
            rows, (s, c, b, o) = self.moving[:, j], values[4 * j : 4 * j + 4]
            speed = self.motion.velocity_rad_s[rows, j]
            base = np.column_stack([rigid_nm[rows, j], np.sign(speed), speed, -np.ones(len(speed))])
            block = np.zeros((len(speed), len(values)))
            block[:, 4 * j : 4 * j + 4] = base
            block[:, self.delay] = -s * rate[rows, j]
            block[:, self.delay + 1 :] = s * slopes[rows, j]
            blocks.append(block)
            residuals.append(self.motion.measured_nm[rows, j] - base @ np.array([s, c, b, o]))
            weights.append(np.full(len(speed), 1.0 / residuals[-1].std()))
            joints.append(np.full(len(speed), j))
        columns, residual, weight = map(np.concatenate, (blocks, residuals, weights))
        return columns, residual, weight, np.concatenate(joints)


def _arm_fit(solver: _Solver, values: FloatArray, covariance: FloatArray, residual_nm: FloatArray) -> ArmFit:
    """Compute gain, offset and friction from their ratios, with uncertainties to first order."""
    motion, delay = solver.motion, solver.delay
    ratios, std = values[:delay].reshape(-1, 4), np.sqrt(np.diag(covariance))
    gain = 1.0 / ratios[:, 0]
    first = np.arange(0, delay, 4)

    def times_gain(k: int) -> UncertainArray:
        slopes = np.zeros((len(gain), len(values)))
        slopes[np.arange(len(gain)), first + k] = gain
        slopes[np.arange(len(gain)), first] = -ratios[:, k] * gain**2
        return UncertainValue(
            gain * ratios[:, k], np.sqrt(np.einsum("ip,pq,iq->i", slopes, covariance, slopes))
        )

    offset = times_gain(3)
    tilt, tilt_std = np.full(2, np.nan), np.full(2, np.nan)
    tilt[solver.axes], tilt_std[solver.axes] = values[delay + 1 :], std[delay + 1 :]
    difference = motion.measured_nm - motion.sent_nm
    shift = difference.mean(axis=0)
    shift_std = np.sqrt(np.diag(sum_covariance(difference - shift).matrix)) / len(difference)
    return ArmFit(
        gain=UncertainValue(gain, gain**2 * std[first]),
        offset_nm=offset,
        command_offset_nm=UncertainValue(
            offset.value + gain * shift, np.hypot(offset.std_err, gain * shift_std)
        ),
        coulomb_nm=times_gain(1),
        viscous_nms_rad=times_gain(2),
        delay_s=UncertainValue(float(values[delay]), float(std[delay])),
        tilt_rad=UncertainValue(tilt, tilt_std),
        residual_nm=residual_nm,
        measured_nm=motion.measured_nm,
        position_rad=motion.position_rad,
        velocity_rad_s=motion.velocity_rad_s,
    )


def _means(values: FloatArray) -> FloatArray:
    """Return the means of blocks of `BLOCK` samples, along the first axis."""
    # Both sides of a linear equation may be filtered alike. This removes the controller's response to the
    # encoders' noise, which affects the measured torque and, smoothed differently, the acceleration.
    count = len(values) // BLOCK
    return np.asarray(values[: count * BLOCK].reshape(count, BLOCK, *values.shape[1:]).mean(axis=1))
