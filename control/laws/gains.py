"""Controller gains, the section `gains` of a robot file."""

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
    integral_rate_1_s: NotNegative = 6.0  # rate at which a constant disturbance is compensated [1/s]
    derivative_filter_s: Annotated[NotNegative, Field(le=0.1)] = 0.001  # low-pass on the velocity error [s]
    acceleration_limit_rad_s2: Positive = 400.0  # largest output of the PID [rad/s^2]

    @model_validator(mode="after")
    def _check_integral(self) -> "TrackingGains":
        if self.integral_rate_1_s > 0.5 * self.bandwidth_rad_s * self.damping_ratio:
            raise ValueError(
                f"integral_rate_1_s {self.integral_rate_1_s} is too fast for bandwidth_rad_s "
                f"{self.bandwidth_rad_s}; at most 0.5 * bandwidth_rad_s * damping_ratio is allowed"
            )
        return self


class TouchGains(FileModel):
    """Contact detection from the force above the free-air mean."""

    touch_force_n: Positive = 0.3  # contact above this force; the task raises it for a noisier sensor [N]
    # contact ends below this share of the touch force.
    release_share: Annotated[Positive, Field(lt=1.0)] = 0.5
    # consecutive new force samples before the state changes.
    debounce_samples: Annotated[int, Field(ge=1, le=100)] = 2
    # largest touch force as a share of the plan's force limit; a larger one prevents probing.
    limit_share: Share = 0.35
    # likewise for the force in free air, which is tared as the sensor's bias.
    bias_share: NotNegative = 0.5


class ContactGains(FileModel):
    """Gains of the force law in contact."""

    # virtual mass of the admittance; the object's damping over it is the fastest reaction [kg].
    mass_kg: Positive = 1.0
    # damping ratio of virtual mass, damping and the object's stiffness.
    damping_ratio: Annotated[Positive, Field(le=5.0)] = 1.0
    damping_min_n_s_m: Positive = 5.0  # least virtual damping [N s/m]
    # fastest reaction on a damped object; delays of sensor and drives limit it.
    reaction_rad_s: Positive = 200.0
    braking_m_s2: Positive = 4.0  # planned deceleration when loading approaches the force limit [m/s^2]
    # largest change of speed in contact, when the force is above the limit [m/s^2].
    yielding_m_s2: Positive = 30.0
    # share of the force limit at which loading ends; the rest is margin, and is reached by the hold.
    loading_aim: Annotated[Share, Field(ge=0.96)] = 0.98
    # delay from a force to the responding motion: sensor, tick, drives [s].
    latency_s: Annotated[NotNegative, Field(le=0.1)] = 0.003
    force_feedforward: Share = 1.0  # share of the measured force that the joints compensate


class DisturbanceObserverGains(FileModel):
    """Gains of the check of joint torques against the force sensor; see `laws.disturbance_observer`."""

    share: Share = 0.5  # threshold as a share of the plan's force limit, plus
    floor_n: Positive = 4.0  # force that weight and friction may leave unexplained [N]
    filter_s: Annotated[NotNegative, Field(le=0.1)] = 0.005  # low-pass on the difference [s]
    samples: Annotated[int, Field(ge=1, le=100)] = 3  # consecutive ticks before a trip


class Gains(FileModel):
    """All gains of an arm; sections and keys may be left out."""

    tracking: TrackingGains = TrackingGains()
    touch: TouchGains = TouchGains()
    contact: ContactGains = ContactGains()
    disturbance_observer: DisturbanceObserverGains = DisturbanceObserverGains()


def gains_of(robot_file: RobotFile) -> Gains:
    """Read and validate the gains of a robot file.

    Raises:
        InputError: a gain is invalid; the error names file, line, key and valid values.
    """
    return validate(Gains, robot_file.gains, robot_file.document, ("gains",))
