"""Which servos are on an emulated line, and how each sits on its joint."""

from math import pi
from typing import Annotated

from pydantic import Field, field_validator

from robot_io.files.file_model import FileModel, Number, Positive
from sim_backend.emulators.dynamixel.control_table import MODELS


class Mounting(FileModel, extra="ignore"):
    """One servo as it is bolted to the arm, which is not always what the robot file says."""

    id: Annotated[int, Field(ge=0, le=252)]  # its id
    model: str  # such as XM430-W350
    reversed: bool = False  # whether a positive count turns the joint backwards
    zero_rad: Number = pi  # joint angle where the servo shows position 0, whole turns aside [rad]
    # Of this very servo; None is as its model's data sheet says [N m/A].
    torque_constant_nm_a: Positive | None = None
    firmware: int = 46  # version

    @field_validator("model")
    @classmethod
    def _know_the_model(cls, name: str) -> str:
        if name not in MODELS:
            raise ValueError(f"no such model is emulated. Valid: {', '.join(MODELS)}")
        return name
