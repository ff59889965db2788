"""Read a calibration file of LeRobot, and print the settings of the same servos for a robot file.

Run: python -m palpate.robot_io.drivers.feetech.lerobot my_follower.json

LeRobot writes the homing offsets into the servos, and stores them in a JSON file with the ends of each
joint's range; zero degrees is the middle of that range. Source: huggingface/lerobot, `MotorCalibration` and
`MotorNormMode.DEGREES`.
"""

import json
import sys
from pathlib import Path
from typing import Annotated

from pydantic import Field, RootModel, model_validator

from palpate.robot_io.drivers.feetech.tables import COUNTS_PER_REVOLUTION, POSITION_STEP_RAD, HomingOffset
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import FileModel, read_text, validate

Count = Annotated[int, Field(ge=0, lt=COUNTS_PER_REVOLUTION, strict=True)]


class LerobotMotor(FileModel):
    """One joint of a LeRobot calibration."""

    id: Annotated[int, Field(ge=0, le=252, strict=True)]  # of its servo
    drive_mode: Annotated[int, Field(ge=0, le=1, strict=True)]  # 1: counts up are backwards
    homing_offset: HomingOffset  # as written into the servo
    range_min: Count  # lowest position it shows
    range_max: Count  # highest position it shows

    @model_validator(mode="after")
    def _check_range(self) -> "LerobotMotor":
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min {self.range_min} is not below range_max {self.range_max}")
        return self

    @property
    def zero_rad(self) -> float:
        """Joint angle at the servo's position 0 [rad]."""
        middle_rad = 0.5 * (self.range_min + self.range_max) * POSITION_STEP_RAD
        return middle_rad if self.drive_mode else -middle_rad


class LerobotCalibration(RootModel[Annotated[dict[str, LerobotMotor], Field(min_length=1)]]):
    """The whole file: joints by LeRobot's names."""

    @model_validator(mode="after")
    def _check_ids_differ(self) -> "LerobotCalibration":
        ids = [motor.id for motor in self.root.values()]
        twice = next((servo_id for servo_id in ids if ids.count(servo_id) > 1), None)
        if twice is not None:
            raise ValueError(f"id {twice} appears twice")
        return self


def read_calibration(path: Path) -> dict[str, LerobotMotor]:
    """Read the joints in a LeRobot calibration, by name.

    Args:
        path: JSON file that LeRobot's calibration wrote.

    Raises:
        InputError: the file cannot be read, or is not a calibration; the error names the first problem.
    """
    try:
        return validate(LerobotCalibration, json.loads(read_text(path))).root
    except (OSError, ValueError, RecursionError, InputError) as error:
        raise InputError(f"{path}: not a LeRobot calibration ({error})") from error


def main(arguments: list[str]) -> int:
    """Print a line of a robot file for each joint; return the exit code, 2 for bad input.

    Args:
        arguments: arguments of the command, the path of a calibration file.
    """
    if len(arguments) != 1:
        print("usage: python -m palpate.robot_io.drivers.feetech.lerobot CALIBRATION.json", file=sys.stderr)
        return 2
    try:
        motors = read_calibration(Path(arguments[0]))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    for name, motor in motors.items():
        turned = ", reversed: true" if motor.drive_mode else ""
        print(
            f"      - {{id: {motor.id}, model: STS3215-12V{turned}, zero_rad: {motor.zero_rad:.5f}, "
            f"homing_offset: {motor.homing_offset}}}   # {name}"
        )
    print("Next: copy the moving joints' lines into 'servos' of your robot file, in order from the base.")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
