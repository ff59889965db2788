"""What a robot file says about a Feetech bus and the servos on it."""

from collections.abc import Collection
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from palpate.robot_io.drivers.feetech.tables import DUTY_PER_RAD, MODELS, FeetechModel
from palpate.robot_io.drivers.servo.settings import ServoBusSettings, ServoMounting
from palpate.robot_io.drivers.servo.stream import LARGEST_ID

HomingOffset = Annotated[int, Field(ge=-2047, le=2047, strict=True)]


class FeetechServo(ServoMounting):
    """One servo; it drives the joint at its place in the list."""

    known_models: ClassVar[Collection[str]] = MODELS

    homing_offset: HomingOffset | None = None

    @property
    def servo_model(self) -> FeetechModel:
        """The model's data."""
        return MODELS[self.model]


class FeetechSettings(ServoBusSettings[FeetechServo]):
    """A bus."""

    baud_rate: Literal[115_200, 250_000, 500_000, 1_000_000] = 1_000_000  # as set in the servos [bit/s]
    # P coefficient of the servos' own position control: a torque is commanded as a distance from where the
    # joint is, so that with more of it torque steps are coarser, and a joint is held more stiffly.
    p_gain: Annotated[int, Field(ge=1, le=100, strict=True)] = 16
    # Ids of servos that are no joints here: they hold where they stand while the torque is on.
    hold: tuple[Annotated[int, Field(ge=0, le=LARGEST_ID, strict=True)], ...] = ()

    @property
    def duty_per_rad(self) -> float:
        """Duty cycle for a position error [1/rad]."""
        return DUTY_PER_RAD * self.p_gain

    @property
    def ids(self) -> tuple[int, ...]:
        """See `ServoBusSettings.ids`; those that hold come last."""
        return (*super().ids, *self.hold)

    @property
    def labels(self) -> tuple[str, ...]:
        """See `ServoBusSettings.labels`."""
        return (*super().labels, *(f"servo {servo_id} (holds)" for servo_id in self.hold))
