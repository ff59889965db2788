"""Which servos are on an emulated line, and how each sits on its joint."""

from math import pi
from typing import Annotated

from pydantic import Field, field_validator

from robot_io.files.file_model import FileModel, Number, Positive
from sim_backend.emulators.dynamixel.control_table import MODELS


class Mounting(FileModel, extra="ignore"):
    """One servo as it is bolted to the arm, which is not always what the robot file says.

    Attributes:
        id: its id.
        model: such as XM430-W350.
        reversed: whether a positive count turns the joint backwards.
        zero_rad: joint angle where the servo shows position 0, whole turns aside [rad].
        torque_constant_nm_a: of this very servo; None is as its model's data sheet says [N m/A].
        firmware: version.
    """

    id: Annotated[int, Field(ge=0, le=252)]
    model: str
    reversed: bool = False
    zero_rad: Number = pi
    torque_constant_nm_a: Positive | None = None
    firmware: int = 46

    @field_validator("model")
    @classmethod
    def _know_the_model(cls, name: str) -> str:
        if name not in MODELS:
            raise ValueError(f"no such model is emulated. Valid: {', '.join(MODELS)}")
        return name
