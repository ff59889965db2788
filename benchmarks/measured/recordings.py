"""Each recording with its simple model, and what its README says is missing in it.

`needed` lists groups of names, one of each of which must be found; `allowed` what may be found besides, as
the README says of its smaller effects. `ladder` are the README's held-out errors, in the effort's unit here.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from palpate.estimation.channel import ChannelData
from palpate.estimation.effects import EFFECTS
from palpate.estimation.model import Model

from . import joints, read, soft

Names = frozenset[str]


def names(*some: str) -> Names:
    """A group of names."""
    return frozenset(some)


COULOMB = names("coulomb_friction", "stribeck_friction", "asymmetric_friction", "presliding_friction")
LOAD = names("load_dependent_friction", "load_dependent_presliding")
PLAY = names("backlash", "loaded_backlash", "hysteresis", "presliding_friction")
STIFFENING = names(
    "power_law_stiffness", "exponential_stiffness", "cubic_stiffness", "hunt_crossley", "layered_stiffness"
)
RELAXATION = names("stress_relaxation", "relaxation_spectrum", "power_law_relaxation")
RUNS = names("run_gain", "run_offset")
RATE = names("stribeck_friction", "quadratic_friction", "asymmetric_friction", "viscous_friction")
RIPPLE = names("torque_ripple")


@dataclass(frozen=True)
class Expected:
    """What the literature says of one channel."""

    needed: tuple[Names, ...]  # groups; at least one name of each group must be found
    allowed: Names  # further names that are no mistake
    ladder: tuple[float, ...]  # held-out errors of the README, from the simple model to its best
    said: str  # the README in few words


@dataclass(frozen=True)
class Recording:
    """One measured set, or a part of it that stands by itself."""

    name: str  # of it
    channels: list[ChannelData]  # those that are diagnosed together
    models: list[Model]  # simple model of each
    expected: list[Expected]  # of each
    unit: str = ""  # of the effort, where it is neither a force nor a torque


def model(name: str, *effects: str) -> Model:
    """A model out of effects by name."""
    return Model(name, tuple(EFFECTS[effect]() for effect in effects))


def _one(name: str, data: ChannelData, base: Model, expected: Expected, unit: str = "") -> Recording:
    return Recording(name, [data], [base], [expected], unit)


def emps(folder: Path) -> Iterator[Recording]:
    """Linear drive."""
    base = model("inertia", "inertia", "viscous_friction", "bias")
    # each recording by itself shows the motion 0.9 to 1.2 ms later than the force
    said = Expected((COULOMB,), RATE | {"delay"}, (9.65, 3.21, 3.17), "Coulomb 20.4 N, slight asymmetry")
    yield _one("emps", read.emps(folder), base, said)


def xl330_pendulum(folder: Path) -> Iterator[Recording]:
    """Servo with a pendulum."""
    base = model("pendulum", "pendulum", "viscous_friction", "gravity_tilt")
    # beside load-dependent friction, Coulomb's adds nothing to the README's regression: 0.563 V either way
    said = Expected((LOAD,), COULOMB | RATE, (0.835, 0.696, 0.563), "Coulomb, then load-dependent friction")
    yield _one("xl330_pendulum", read.pendulum(folder), base, said, "V")


def silverbox(folder: Path) -> Iterator[Recording]:
    """Resonator; its README's errors are of free runs, which cannot be compared."""
    base = model("spring_mass_damper", "inertia", "damping", "stiffness")
    said = Expected((names("cubic_stiffness"),), names("delay", "lag"), (), "cubic stiffness")
    yield _one("silverbox", read.silverbox(folder), base, said, "V")


def load_cell(folder: Path) -> Iterator[Recording]:
    """Two cells: a bias and nothing else."""
    ladders = ((3952.9, 78.8), (8465.0, 81.9))
    for cell, ladder in zip(read.load_cells(folder), ladders, strict=True):
        said = Expected((names("bias"),), names(), ladder, "bias and nothing else")
        yield _one(f"load_cell {cell.name}", cell, model("gain", "stiffness"), said, "counts")


def soft_indentation(folder: Path) -> Iterator[Recording]:
    """Soft specimen."""
    base = model("kelvin_voigt", "stiffness", "damping")
    said = Expected(
        (STIFFENING, RELAXATION),
        RUNS,
        (0.0586, 0.0491, 0.0296, 0.0210),
        "stiffening exponent 1.25, two relaxations",
    )
    yield _one("soft_indentation", read.indentation(folder), base, said)


def servo_backlash(folder: Path) -> Iterator[Recording]:
    """Servo under pull, and its control."""
    base = model("elastic", "stiffness", "bias")
    play = "backlash, 6 counts and more"
    logs = {
        "single": (5, Expected((PLAY,), names(), (3.37, 1.93), play)),
        "nocomp2": (1, Expected((PLAY,), names(), (2.31, 1.78), play)),
        "comp2": (1, Expected((), names(), (0.89,), "nothing: a control")),
    }
    for log, (motor, said) in logs.items():
        data = read.servo(folder, f"motor_telemetry_{log}", motor)
        yield _one(f"servo_backlash {log}", data, base, said, "counts")


def motor_cogging(folder: Path) -> Iterator[Recording]:
    """Motor mapped at standstill, and in motion."""
    said = Expected(
        (RIPPLE, COULOMB), RATE, (3.654e-3, 1.264e-3, 0.796e-3, 0.522e-3), "cogging 72 (18, 12 ...), Coulomb"
    )
    yield _one("motor_cogging map", joints.cogging_map(folder), model("constant", "bias"), said)
    base = model("inertia", "inertia", "viscous_friction")
    fast = Expected((COULOMB,), RATE | {"bias"}, (0.845e-3, 0.462e-3, 0.389e-3), "Coulomb, v|v|; no cogging")
    slow = ((4.382e-3, 1.639e-3, 1.009e-3), (3.904e-3, 1.494e-3, 0.962e-3))
    yield _one("motor_cogging motion 1", joints.cogging_motion(folder, 1, 20.0), base, fast)
    for run, ladder in zip((2, 3), slow, strict=True):
        said = Expected((RIPPLE,), COULOMB | RATE | {"bias"}, ladder, "cogging 72 (18, 12 ...)")
        yield _one(f"motor_cogging motion {run}", joints.cogging_motion(folder, run, 200.0), base, said)


def surgical_tool(folder: Path) -> Iterator[Recording]:
    """Cable-driven tool, two specimens; the jaw's torque is the load."""
    base = model("spring", "joint_spring", "viscous_friction")
    ladders = {"tool_4": (29.76e-3, 21.61e-3, 9.28e-3), "tool_5": (29.24e-3, 19.70e-3, 9.04e-3)}
    for name, ladder in ladders.items():
        said = Expected(
            (COULOMB, LOAD),
            RATE | RUNS | PLAY | {"joint_elasticity"},
            ladder,
            "Coulomb, load-dependent friction, presliding",
        )
        yield _one(f"surgical_tool {name}", joints.tool(folder, name), base, said)


def afm_cell_relaxation(folder: Path) -> Iterator[Recording]:
    """Cell under an AFM; force zero and contact point are not known."""
    said = Expected(
        (STIFFENING, RELAXATION),
        RUNS | {"contact_offset", "bias", "tool_compliance"},
        (53.13e-9, 7.40e-9, 5.97e-9),
        "two relaxations, exponent 1.5",
    )
    base = model("kelvin_voigt", "stiffness", "damping")
    yield _one("afm_cell_relaxation", soft.afm_cell(folder), base, said)


def muscle_ramps(folder: Path) -> Iterator[Recording]:
    """Muscle under four conditions."""
    ladders = {
        "relaxed": (1.52e-3, 0.81e-3, 0.38e-3),
        "calcium_pCa4.4": (11.49e-3, 1.62e-3, 0.82e-3),
        "relaxed_mava_set": (1.20e-3, 0.67e-3, 0.36e-3),
        "calcium_pCa4.4_mava_set": (15.60e-3, 3.01e-3, 1.37e-3),
    }
    base = model("kelvin_voigt", "stiffness", "damping", "bias")
    for condition in soft.MUSCLES:
        said = Expected(
            (STIFFENING, RELAXATION), RUNS, ladders[condition], "exponent 2 to 4, power-law relaxation"
        )
        yield _one(f"muscle_ramps {condition}", soft.muscle(folder, condition), base, said)


def tx40_arm(folder: Path) -> Iterator[Recording]:
    """Arm of six joints."""
    channels, models = joints.tx40(folder)
    viscous, coulomb = (4.94, 6.96, 5.19, 1.92, 6.22, 2.63), (2.42, 3.02, 2.13, 0.99, 5.83, 2.04)
    best = (2.32, 2.31, 1.48, 0.61, 1.39, 0.69)
    coupled = names("joint_coupling")
    expected = [
        Expected(
            (COULOMB, coupled) if joint >= 4 else (COULOMB,),
            RATE | {"armature", "joint_coupling"},
            ladder,
            "Coulomb, wrist coupling" if joint >= 4 else "Coulomb, rotor inertia; no offset",
        )
        for joint, ladder in enumerate(zip(viscous, coulomb, best, strict=True))
    ]
    yield Recording("tx40_arm", channels, models, expected)


SETS: tuple[Callable[[Path], Iterator[Recording]], ...] = (
    emps,
    xl330_pendulum,
    silverbox,
    load_cell,
    soft_indentation,
    servo_backlash,
    motor_cogging,
    surgical_tool,
    afm_cell_relaxation,
    muscle_ramps,
    tx40_arm,
)
