"""Controller gains, the section `gains` of a robot file, and when a force counts as touch."""

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, model_validator

from palpate.robot_io.files.file_model import FileModel, NotNegative, Positive, validate
from palpate.robot_io.robot_file import RobotFile

Share = Annotated[NotNegative, Field(le=1.0)]


class TrackingGains(FileModel):
    """Computed torque and PID, the same for all joints since the mass matrix decouples them."""

    # natural frequency of a position error, below a tenth of the control rate [rad/s].
    bandwidth_rad_s: Annotated[Positive, Field(le=1000.0)] = 60.0
    damping_ratio: Annotated[Positive, Field(le=5.0)] = 1.0  # 1 is critically damped
    integral_rate_1_s: NotNegative = 6.0  # how fast a constant disturbance is taken out [1/s]
    derivative_filter_s: Annotated[NotNegative, Field(le=0.1)] = 0.001  # low-pass on the velocity error [s]
    acceleration_limit_rad_s2: Positive = 400.0  # largest output of the PID [rad/s^2]

    @model_validator(mode="after")
    def _check_integral(self) -> "TrackingGains":
        if self.integral_rate_1_s > 0.5 * self.bandwidth_rad_s * self.damping_ratio:
            raise ValueError(
                f"integral_rate_1_s {self.integral_rate_1_s} is too fast for bandwidth_rad_s "
                f"{self.bandwidth_rad_s}: at most half of it times damping_ratio"
            )
        return self


class TouchGains(FileModel):
    """When the tool counts as in contact, judged by the force above the free-air mean."""

    touch_force_n: Positive = 0.3  # above it is contact; raised by the task where the sensor is noisier [N]
    # below this share of the touch force is no contact.
    release_share: Annotated[Positive, Field(lt=1.0)] = 0.5
    # new force samples in a row before the state changes.
    debounce_samples: Annotated[int, Field(ge=1, le=100)] = 2
    # largest touch force as a share of the plan's force limit; with a larger one nothing is probed.
    limit_share: Share = 0.35
    # the same for the force in free air, which counts as the sensor's bias and is tared.
    bias_share: NotNegative = 0.5


class ContactGains(FileModel):
    """The force law in contact."""

    # virtual mass of the admittance; the object's damping over it is the fastest reaction [kg].
    mass_kg: Positive = 1.0
    # of virtual mass, damping and the object's stiffness.
    damping_ratio: Annotated[Positive, Field(le=5.0)] = 1.0
    damping_min_n_s_m: Positive = 5.0  # least virtual damping [N s/m]
    # fastest reaction on a damped object; delays of sensor and drives limit it.
    reaction_rad_s: Positive = 200.0
    braking_m_s2: Positive = 4.0  # deceleration planned for when loading comes to the force limit [m/s^2]
    # largest change of speed in contact, when the force is above the limit [m/s^2].
    yielding_m_s2: Positive = 30.0
    # share of the force limit that loading comes to; the rest is margin, and the hold's.
    loading_aim: Annotated[Share, Field(ge=0.96)] = 0.98
    # time from a force to a motion in answer: sensor, tick, drives [s].
    latency_s: Annotated[NotNegative, Field(le=0.1)] = 0.003
    force_feedforward: Share = 1.0  # share of the measured force that the joints compensate


class WitnessGains(FileModel):
    """When joint torques and force sensor contradict each other; see `laws.disturbance_observer`."""

    share: Share = 0.5  # threshold as a share of the plan's force limit, plus
    floor_n: Positive = 4.0  # what weight and friction may leave unexplained [N]
    filter_s: Annotated[NotNegative, Field(le=0.1)] = 0.005  # low-pass on the difference [s]
    samples: Annotated[int, Field(ge=1, le=100)] = 3  # ticks in a row before it counts


class Gains(FileModel):
    """All gains of an arm; sections and keys may be left out."""

    tracking: TrackingGains = TrackingGains()
    touch: TouchGains = TouchGains()
    contact: ContactGains = ContactGains()
    witness: WitnessGains = WitnessGains()


def gains_of(robot_file: RobotFile) -> Gains:
    """Read the gains of a robot file.

    Args:
        robot_file: whose section `gains` is read.

    Returns:
        Validated gains.

    Raises:
        InputError: a gain is invalid; the error names file, line, key and valid values.
    """
    return validate(Gains, robot_file.gains, robot_file.document, ("gains",))


_NOISE_FACTOR = 6.0  # standard deviations of the free-air force that count as contact


def touch_force_n(noise_n: float, least_n: float = 0.0) -> float:
    """Compute the force above the free-air mean from which on there is contact.

    Args:
        noise_n: standard deviation of the force in free air [N].
        least_n: touch force of a quieter sensor, see `TouchGains` [N].

    Returns:
        Touch force [N].
    """
    return max(least_n, _NOISE_FACTOR * noise_n)


def release_force_n(touch_n: float, gains: TouchGains) -> float:
    """Compute the force above the free-air mean below which a contact is over.

    Args:
        touch_n: touch force at which it began [N].
        gains: share of the touch force.

    Returns:
        Release force [N].
    """
    return gains.release_share * touch_n


def free_air_problem(force_n: float, touch_n: float, force_limit_n: float, gains: TouchGains) -> str | None:
    """Describe why no object can be probed with this free-air force.

    The force in free air is tared away: if an object made it, all later forces are wrong by as much. Below
    the touch force an object is not noticed.

    Args:
        force_n: mean force in free air [N].
        touch_n: touch force above it [N].
        force_limit_n: force limit of the plan [N].
        gains: largest shares of the force limit.

    Returns:
        Problem and remedy, or None.
    """
    limit = f"force_limit_n {force_limit_n:g} N"
    most_n = gains.bias_share * force_limit_n
    if not abs(force_n) <= most_n:
        return (
            f"{force_n:.3g} N in free air, with {limit} at most {most_n:.3g} N: is the tool touched? "
            "If not, tare the force sensor, or allow more (gains.touch.bias_share in the robot file)"
        )
    most_n = gains.limit_share * force_limit_n
    if not touch_n <= most_n:
        return (
            f"a touch counts from {touch_n:.3g} N on, with {limit} at most {most_n:.3g} N: the sensor is "
            "too noisy (or gains.touch.touch_force_n of the robot file too high); a force_limit_n of "
            f"{touch_n / gains.limit_share:.3g} N is enough"
        )
    return None


@dataclass
class RunningMean:
    """Mean and standard deviation by Welford's recursion (Technometrics 4(3), 1962)."""

    count: int = 0
    mean: float = 0.0
    _squares: float = 0.0

    def add(self, value: float) -> None:
        """Take in one sample.

        Args:
            value: the sample.
        """
        self.count += 1
        before = value - self.mean
        self.mean += before / self.count
        self._squares += before * (value - self.mean)

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of the samples so far; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0
