"""What to do with a calibration that has been made: the line for the robot file, and the next command."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from palpate import console
from palpate.runs.robots import is_simulated, shipped_robots
from palpate.words import FIRST_PROBE, as_shell_word, safe, shown, typed
from robot_io.calibration import Calibration
from robot_io.robot_file import RobotFile


@dataclass(frozen=True)
class NamedRobot:
    """The robot as the user named it, its file, and the packages of its drivers."""

    named: str
    file: RobotFile
    drivers: list[str] | None

    @property
    def option(self) -> str:
        """As it is typed in the next command."""
        packages = "".join(f" --drivers {as_shell_word(package)}" for package in self.drivers or ())
        return f"--robot {as_shell_word(self.named)}{packages}"


def say_how_to_use_it(calibration: Calibration, path: Path, whose: NamedRobot) -> None:
    """Say on stderr what to write into the robot file, and what to run then.

    Args:
        calibration: what was made.
        path: its file, from the root.
        whose: the robot that it is of.
    """
    talk, file = console.stderr(), whose.file.path
    unit = getattr(calibration, "reading_unit", "N")
    if unit != "N":
        talk.print(f"\nIt is of readings in {unit}. No robot can name it: a robot's driver reads N.")
        again = f"palpate calibrate force {whose.option} --weights-kg 0,0.5,1,2,1,0.5,0"
        console.next_steps((again, "the sensor as the robot reads it"))
        return
    if whose.named in shipped_robots():
        talk.print(f"\nTo use it, copy the shipped arm, and write into the copy's {safe(file.name)}:")
    else:
        talk.print(f"\nTo use it, write into {shown(file)}:", soft_wrap=True)
    named = {kind: name for kind, name in whose.file.calibration.model_dump().items() if name is not None}
    folder = file.resolve().parent
    named[calibration.kind] = str(path.relative_to(folder) if path.is_relative_to(folder) else path)
    line = yaml.safe_dump(named, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10_000)
    talk.print(f"  calibration: {safe(line.strip())}", soft_wrap=True)
    wire = " --wire" if calibration.source == "emulated" else ""
    if wire:
        talk.print("It is of emulated devices: with --wire it is used, on the arm itself refused.")
    if whose.named in shipped_robots():
        copy = Path(f"my_{whose.named}")
        console.next_steps(
            (f"cp -r {typed(file.parent)} {copy}", "the arm, to be changed"),
            (
                f"palpate probe --robot {copy / file.name}",
                "probe with it, once the robot file names it",
            ),
        )
        return
    gentle = "" if is_simulated(whose.file) else f" {FIRST_PROBE}"
    console.next_steps(
        (f"palpate probe {whose.option}{wire}{gentle}", "probe with it, once the robot file names it")
    )
