"""Options that the calibrations share, and what they mean."""

from pathlib import Path
from typing import Annotated

import typer

from control.arm.rigid_body import RigidBody
from palpate.arm.robots import shipped_robots
from palpate.calibrating.run import stated_stops
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile
from robot_io.types import FloatArray
from sim_backend.scenario import shipped_scenarios

RobotOption = Annotated[
    str, typer.Option(help=f"Robot file, or a shipped arm: {', '.join(shipped_robots())}.")
]
OutOption = Annotated[Path | None, typer.Option("--out", "-o", help="Calibration file to write (YAML).")]
SessionOption = Annotated[Path | None, typer.Option(help="Session file to write.")]
FromOption = Annotated[
    Path | None,
    typer.Option("--from", help="Work it out again from a session; nothing moves.", metavar="FILE"),
]
ValidOption = Annotated[
    float, typer.Option(help="How long it may be used.", metavar="DAYS", min=0.01, max=3650)
]
ScenarioOption = Annotated[
    str | None, typer.Option(help=f"Simulated world: a file, or one of {', '.join(shipped_scenarios())}.")
]
SeedOption = Annotated[int | None, typer.Option(help="Seed of all simulated noise.", min=0)]
HiddenOption = Annotated[
    str | None,
    typer.Option(help="Hide effects in the simulated world, as for palpate probe.", metavar="WHAT"),
]
WireOption = Annotated[
    bool, typer.Option("--wire", help="Emulate the devices of a robot of hardware drivers, byte by byte.")
]
RealtimeOption = Annotated[bool, typer.Option("--realtime", help="Simulate no faster than time passes.")]
DriversOption = Annotated[
    list[str] | None, typer.Option(help="Python package with drivers of your own.", metavar="PACKAGE")
]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask before a real arm gets power.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the calibration as JSON.")]

BEYOND_STOPS_RAD = 0.1  # an arm may be held against its stops, which are not quite where the URDF says


def numbers(option: str, text: str) -> list[float]:
    """Numbers with commas between them.

    Raises:
        InputError: they are none.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} {text!r}: give numbers with commas between them") from None
    if not all(abs(number) < 1e6 for number in numbers):  # also NaN
        raise InputError(f"{option} {text!r}: give finite numbers")
    return numbers


def joint_angles(option: str, text: str, robot_file: RobotFile) -> list[float]:
    """One angle per joint [rad], or those of home.

    Raises:
        InputError: they are none, or of another number.
    """
    if text == "home":
        return list(robot_file.home_rad)
    angles = numbers(option, text)
    if len(angles) != robot_file.joint_count:
        raise InputError(
            f"{option} {text!r}: {len(angles)} angles, the robot has {robot_file.joint_count} joints"
        )
    return angles


def stops_of(
    lower: str | None, upper: str | None, robot_file: RobotFile
) -> tuple[FloatArray, FloatArray] | None:
    """Lower and upper stops that are stated, (n,) each [rad]; None for the URDF's on both sides.

    Raises:
        InputError: one of them is no list of angles, or a lower stop is not below its upper one.
    """
    if lower is None and upper is None:
        return None
    low_rad = None if lower is None else joint_angles("--lower-stops", lower, robot_file)
    high_rad = None if upper is None else joint_angles("--upper-stops", upper, robot_file)
    for joint, (low, high) in enumerate(zip(low_rad or (), high_rad or (), strict=False), 1):
        if low >= high:
            raise InputError(
                f"--lower-stops {lower!r}: {low:g} rad of joint {joint} is not below its upper stop, "
                f"{high:g} rad"
            )
    return stated_stops(low_rad, high_rad)


def pose_of(pose: str | None, robot_file: RobotFile) -> list[float] | None:
    """The pose that is stated, (n,) [rad]; None where none is.

    Raises:
        InputError: it is no list of angles, or no joint of this arm can be turned so far.
    """
    if pose is None:
        return None
    angles = joint_angles("--pose", pose, robot_file)
    lower_rad, upper_rad = RigidBody.from_urdf(robot_file.urdf_path, robot_file.tip_frame).position_limits_rad
    for joint, (angle, low, high) in enumerate(zip(angles, lower_rad, upper_rad, strict=True), 1):
        if not low - BEYOND_STOPS_RAD <= angle <= high + BEYOND_STOPS_RAD:
            raise InputError(
                f"--pose {pose!r}: joint {joint} turns from {low:g} to {high:g} rad by the URDF, "
                f"not to {angle:g}"
            )
    return angles
