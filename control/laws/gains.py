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
