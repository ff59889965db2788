"""Diagnoses measured sets, each from its simple model, beside what others found missing in them.

    python benchmarks/real_data.py DATA_DIR [SET ...]

The sets are described where they come from (see docs/diagnosis.md); they are no part of this project.
"""

import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from measured import read
from measured.free_run import free_run, refined

from estimation.channel import ChannelData
from estimation.diagnosis import ChannelDiagnosis, diagnose
from estimation.effects import EFFECTS
from estimation.model import Model
from estimation.revision import revise

Case = tuple[str, ChannelData, Model, str]  # name, data, simple model, what others found


def model(name: str, *effects: str) -> Model:
    """A model out of effects by name."""
    return Model(name, tuple(EFFECTS[effect]() for effect in effects))


def emps(folder: Path) -> Iterator[Case]:
    """Linear drive."""
    base = model("inertia", "inertia", "viscous_friction", "bias")
    yield "emps", read.emps(folder), base, "Coulomb friction 20.4 N; 9.65 -> 3.21 N"


def xl330_pendulum(folder: Path) -> Iterator[Case]:
    """Servo with a pendulum."""
    base = model("pendulum", "pendulum", "viscous_friction", "gravity_tilt")
    said = "Coulomb and load-dependent friction; 0.835 -> 0.696 -> 0.563 V"
    yield "xl330_pendulum", read.pendulum(folder), base, said


def silverbox(folder: Path) -> Iterator[Case]:
    """Resonator."""
    base = model("spring_mass_damper", "inertia", "damping", "stiffness")
    yield (
        "silverbox",
        read.silverbox(folder)[0],
        base,
        "cubic stiffness; free run on the arrow 13.6 -> 1.05 mV",
    )


def load_cell(folder: Path) -> Iterator[Case]:
    """Two cells; a control."""
    for cell in read.load_cells(folder):
        yield f"load_cell {cell.name}", cell, model("gain", "stiffness"), "bias and nothing else"


def soft_indentation(folder: Path) -> Iterator[Case]:
    """Soft specimen."""
    base = model("kelvin_voigt", "stiffness", "damping")
    said = "stiffening and relaxation; 58.6 -> 49.1 -> 29.6 -> 21.0 mN"
    yield "soft_indentation", read.indentation(folder), base, said


def servo_backlash(folder: Path) -> Iterator[Case]:
    """Servo under pull, and its control."""
    logs = {"single": (5, "backlash"), "nocomp2": (1, "backlash"), "comp2": (1, "nothing: a control")}
    for log, (motor, said) in logs.items():
        data = read.servo(folder, f"motor_telemetry_{log}", motor)
        yield f"servo_backlash {log}", data, model("elastic", "stiffness", "bias"), said


SETS: tuple[Callable[[Path], Iterator[Case]], ...] = (
    emps,
    xl330_pendulum,
    silverbox,
    load_cell,
    soft_indentation,
    servo_backlash,
)


# Of sets whose effort is neither a force nor a torque.
UNITS = {"xl330_pendulum": "V", "silverbox": "V", "load_cell": "counts", "servo_backlash": "counts"}


def tell(name: str, found: ChannelDiagnosis, said: str, seconds: float, unit: str) -> None:
    """Print one finding, in the unit that the effort really has."""

    def say(line: str) -> None:
        print(re.sub(rf" {found.effort_unit}\b", f" {unit}", line))

    say(f"\n{name}: {found.verdict.value} ({seconds:.1f} s); others found: {said}")
    say(f"  {found.reason}")
    if found.baseline is None or found.final is None:
        return
    say(
        f"  held-out error {found.baseline.rmse:.4g} -> {found.final.rmse:.4g}, floor {found.noise_floor:.4g}"
    )
    for entry in found.accepted:
        values = ", ".join(f"{k} = {v.value:.4g} {v.unit}" for k, v in entry.parameters.items())
        also = f"; or {', '.join(entry.confused_with)}" if entry.confused_with else ""
        say(f"  + {entry.effect} ({values}): {entry.rmse_before:.4g} -> {entry.rmse_after:.4g}{also}")
    for suspect in found.suspects:
        also = f" (or {', '.join(suspect.confused_with)})" if suspect.confused_with else ""
        say(f"  ? {suspect.effect}{also}: -> {suspect.rmse_after:.4g}, but too much is left to name it")
    if found.depends_on:
        say(f"  what is left depends on: {', '.join(found.depends_on)}")


def tell_free_run(folder: Path) -> None:
    """Print the resonator's free run on the arrow, before and after, as found and refined on other runs."""
    data, u, y = read.silverbox(folder)
    step_s = read.SILVERBOX_STEP_S
    runs = [(data.effort[data.run == run], data.position[data.run == run]) for run in data.runs[:3]]
    for stage in revise(data, model("smd", "inertia", "damping", "stiffness"), ["cubic_stiffness"]):
        found = {name: entry.value for name, entry in stage.parameters.items()}
        errors = [
            1e3 * float(np.sqrt(np.mean((free_run(u, step_s, parameters) - y)[50:] ** 2)))
            for parameters in (found, refined(runs, step_s, found))
        ]
        added = stage.added or "the base model"
        print(
            f"  free run on the arrow with {added}: {errors[0]:.2f} mV; "
            f"refined by free runs on others, with their shift: {errors[1]:.2f} mV"
        )


def main() -> None:
    """Run the sets named on the command line, or all."""
    if len(sys.argv) < 2:
        print(__doc__)
        raise SystemExit(2)
    folder, wanted = Path(sys.argv[1]), sys.argv[2:]
    for cases in SETS:
        if wanted and cases.__name__ not in wanted:
            continue
        for name, data, base, said in cases(folder / cases.__name__):
            started = time.perf_counter()
            found = diagnose(data, base, rng=np.random.default_rng(0), file=name).channels[0]
            unit = UNITS.get(cases.__name__, found.effort_unit)
            tell(name, found, said, time.perf_counter() - started, unit)
        if cases is silverbox:
            tell_free_run(folder / "silverbox")


if __name__ == "__main__":
    main()
