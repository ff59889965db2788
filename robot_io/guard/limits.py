"""What the guard holds an arm to, and how it brings it to rest."""

from typing import Annotated, NamedTuple

from pydantic import Field, model_validator

from robot_io.files.file_model import FileModel, NotNegative, Number, Positive

# Bounds beyond any arm that this guard is for: a limit past them would be no limit.
Position = Annotated[Number, Field(ge=-100.0, le=100.0)]
Torque = Annotated[Positive, Field(le=1e4)]
TorqueRate = Annotated[Positive, Field(le=1e7)]
Speed = Annotated[Positive, Field(le=100.0)]
Distance = Annotated[Positive, Field(le=2.0)]
Force = Annotated[Positive, Field(le=5000.0)]
Age = Annotated[Positive, Field(le=10.0)]
Patience = Annotated[Positive, Field(le=10.0)]


class Limits(FileModel):
    """Limits of one arm; a list holds one value per joint."""

    # Largest torque that is sent; commands are clipped to it [N m].
    torque_nm: Annotated[tuple[Torque, ...], Field(min_length=1)]
    torque_rate_nm_s: tuple[TorqueRate, ...]  # largest change of torque; commands are clipped to it [N m/s]
    position_min_rad: tuple[Position, ...]  # lowest position before a trip [rad]
    position_max_rad: tuple[Position, ...]  # highest position before a trip [rad]
    velocity_rad_s: tuple[Speed, ...]  # largest speed before a trip, either way [rad/s]
    force_n: Force  # largest contact force before a trip, push or pull [N]
    tracking_rad: tuple[Distance, ...]  # largest distance from the reference before a trip [rad]
    encoder_age_s: Age  # oldest position and velocity that are still acted on [s]
    torque_age_s: Age  # oldest measured torque that is still acted on [s]
    force_age_s: Age  # oldest force that is still acted on [s]
    # How long a drive may show less than half of any torque that it was sent of late [s].
    deaf_drive_s: Patience = 0.01
    # How long an encoder may stand still while its reference and its drive's torque move on [s].
    stuck_encoder_s: Patience = 0.02
    # How long a force sensor that has never done so may repeat one number while the arm moves [s].
    stuck_force_s: Patience = 0.02

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self.torque_nm)

    @model_validator(mode="after")
    def _agree(self) -> "Limits":
        for name in (
            "torque_rate_nm_s",
            "position_min_rad",
            "position_max_rad",
            "velocity_rad_s",
            "tracking_rad",
        ):
            count = len(getattr(self, name))
            if count != self.joint_count:
                raise ValueError(
                    f"{name} has {count} values, torque_nm has {self.joint_count}: one per joint"
                )
        for joint, (low, high) in enumerate(
            zip(self.position_min_rad, self.position_max_rad, strict=True), 1
        ):
            if low >= high:
                raise ValueError(
                    f"position_min_rad {low} is not below position_max_rad {high} of joint {joint}"
                )
        return self


class SafeState(FileModel):
    """How a tripped arm comes to rest: it is braked, then lowered, then the torque goes off.

    Braking is torque = -damping * velocity, with the arm's weight held up. Keep damping * (tick + age of the
    velocity) below the smallest inertia that the joint moves; from twice that on, the brake itself would
    shake the arm. For an arm with brakes of its own `lower_time_s` can be 0.
    """

    # One value per joint [N m s/rad]; 0 lets a joint go at once.
    damping_nms_rad: Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    stop_time_s: Annotated[NotNegative, Field(le=10)]  # time from the trip for braking [s]
    # Time after it in which the arm sinks, until the torque goes off [s].
    lower_time_s: Annotated[NotNegative, Field(le=10)] = 3.0
    lower_speed_rad_s: Annotated[Positive, Field(le=2.0)] = 0.3  # how fast it sinks meanwhile [rad/s]


class Problem(NamedTuple):
    """One reason to stop."""

    text: str  # one sentence without its full stop: what is wrong, where, and by how much
    # What to do, for the end of the line that the user reads; empty where nobody can do anything.
    remedy: str = ""
