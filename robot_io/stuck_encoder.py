"""Finds an encoder that has frozen: it goes on sampling one and the same number while its joint moves.

A joint at rest also reads one number, and so does one that friction holds. What tells them apart:

- its reference has moved on, by several of the encoder's own steps;
- the drive has answered with a torque that no friction of a sound joint holds back;
- and not one step has been seen, in several new samples.

A joint that is jammed looks the same, and is as good a reason to stop.
"""

from math import inf, isfinite

from robot_io.limits import Limits
from robot_io.types import FloatArray, Measurement

_SAMPLES = 5  # new samples in a row without a step; fewer are a drive that measures slower than it is asked
_STEPS = 4  # of the encoder, that the reference must have moved, and
_TRACKING_SHARE = 0.01  # this share of the tracking limit; or
_UNKNOWN_SHARE = 0.1  # this one, as long as no step has been seen that would tell their size
_TORQUE_SHARE = 0.1  # of the torque limit, by which the torque must have changed


class _Joint:
    """One joint since its reading last changed."""

    __slots__ = (
        "least_rad",
        "position_rad",
        "reference_rad",
        "samples",
        "step_rad",
        "torque_nm",
        "unknown_rad",
    )

    def __init__(self, tracking_rad: float) -> None:
        self.least_rad = _TRACKING_SHARE * tracking_rad
        self.unknown_rad = _UNKNOWN_SHARE * tracking_rad
        self.step_rad = inf  # smallest one seen
        self.samples = 0
        self.position_rad = self.reference_rad = self.torque_nm = 0.0

    def begin(self, position_rad: float, reference_rad: float, torque_nm: float) -> None:
        """A reading that differs from the one before, or is the first."""
        if self.samples:
            self.step_rad = min(self.step_rad, abs(position_rad - self.position_rad))
        self.samples = 1
        self.position_rad, self.reference_rad, self.torque_nm = position_rad, reference_rad, torque_nm

    @property
    def most_rad(self) -> float:
        """How far a reference moves before a sound encoder shows it, friction aside."""
        return max(self.least_rad, _STEPS * self.step_rad) if isfinite(self.step_rad) else self.unknown_rad


class StuckEncoders:
    """Remembers for each joint since when its reading has stood still, and what has happened since.

    Args:
        limits: of the arm; shares of them are the thresholds.
    """

    def __init__(self, limits: Limits) -> None:
        self._joints = tuple(_Joint(tracking_rad) for tracking_rad in limits.tracking_rad)
        self._most_nm = tuple(_TORQUE_SHARE * torque_nm for torque_nm in limits.torque_nm)
        self._sampled_at_s = -inf

    def restart(self) -> None:
        """Forget since when; what is known about the size of the steps stays."""
        self._sampled_at_s = -inf
        for joint in self._joints:
            joint.samples = 0

    def problem(self, measurement: Measurement, reference_position_rad: FloatArray) -> str | None:
        """The first joint whose encoder has frozen, or None.

        Args:
            measurement: this tick's; one without a new sample of the encoders says nothing.
            reference_position_rad: where the joints should be, shape (n,) [rad].
        """
        if not measurement.encoder_at_s > self._sampled_at_s:
            return None
        self._sampled_at_s = measurement.encoder_at_s
        values = zip(
            measurement.joint_position_rad.tolist(),
            reference_position_rad.tolist(),
            measurement.joint_torque_nm.tolist(),
            strict=True,
        )
        found = None
        for number, (position_rad, reference_rad, torque_nm) in enumerate(values, 1):
            joint = self._joints[number - 1]
            if not joint.samples or position_rad != joint.position_rad:
                joint.begin(position_rad, reference_rad, torque_nm)
                continue
            joint.samples += 1
            moved_rad, pushed_nm = abs(reference_rad - joint.reference_rad), abs(torque_nm - joint.torque_nm)
            if (
                found is None
                and joint.samples >= _SAMPLES
                and moved_rad > joint.most_rad
                and pushed_nm > self._most_nm[number - 1]
            ):
                found = (
                    f"encoder of joint {number}: stuck at {position_rad:.4g} rad (or the joint is jammed), "
                    f"while its reference moved by {moved_rad:.2g} rad and its torque by {pushed_nm:.2g} N m"
                )
        return found
