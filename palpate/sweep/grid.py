"""YAML file of a sweep: objects, speeds, noise, hidden effects and estimators.

Each combination of its lists is one case, repeated `repeats` times. A parameter of an object's law may be a
list, or a range {from: 200, to: 2000, step: 200}.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from palpate.control.probing.plan import ProbingPlan
from palpate.estimation.contact_estimators import CONTACT_ESTIMATORS
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.models import MODELS
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive, problem_at, validate
from palpate.runs.probing import check_duration
from palpate.runs.robots import find_robot
from palpate.sim_backend.contact_laws.standard import HuntCrossleyLaw
from palpate.sweep.case import Case
from palpate.sweep.tasks.probing import NOTHING, make_estimator, world

SHIPPED = Path(__file__).parent / "grids"
ESTIMATE, DIAGNOSE = "palpate.sweep.tasks.probing:estimate", "palpate.sweep.tasks.probing:diagnose"
ALL = "all"
MOST_CASES = 1_000_000
_MILLI = 1e-3
Speed = Annotated[Positive, Field(le=1000.0)]
Spec = str | dict[str, str | float]
Hidden = str | list[dict[str, Any]]


class ParameterRange(FileModel):
    """Evenly spaced numbers, both ends included."""

    from_: Annotated[Number, Field(alias="from")]
    to: Number
    step: Positive

    def values(self) -> list[float]:
        """Return all numbers of the range; raise `InputError` if there are too many."""
        steps = (self.to - self.from_) / self.step + 1e-9
        if steps >= MOST_CASES:  # may be infinite
            numbers = f"{steps:.3g} numbers from {self.from_:g} to {self.to:g}"
            raise InputError(f"{numbers}; at most {MOST_CASES} are allowed")
        return [round(self.from_ + i * self.step, 12) for i in range(max(math.floor(steps) + 1, 0))]


class GridFile(FileModel):
    """A sweep of simulated probing runs."""

    description: str = ""
    # objects, each a contact law as in a scenario, whose numbers may be lists or ranges.
    objects: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]
    # sets of speeds; each set is one probing run [mm/s].
    speeds_mm_s: Annotated[tuple[tuple[Speed, ...], ...], Field(min_length=1)] = ((150.0, 90.0, 60.0),)
    # Noise of the force sensor [N].
    noise_std_n: Annotated[tuple[NotNegative, ...], Field(min_length=1)] = (0.02,)
    # Gaussian noise on the measured force, as a share of the force [%].
    noise_percent: Annotated[tuple[NotNegative, ...], Field(min_length=1)] = (0.0,)
    draws: Annotated[int, Field(ge=1, le=1000, strict=True)] = 1  # draws of that noise for each probing run
    # hidden effects: "none", "random", the name of an effect, or a list of effects as in a scenario.
    hidden: Annotated[tuple[Hidden, ...], Field(min_length=1)] = (NOTHING,)
    # names, or {name: ransac, threshold: 0.1}; "all" selects all estimators that apply to the model.
    estimators: str | tuple[Spec, ...] = ALL
    diagnose: bool = False  # whether to diagnose instead of estimating
    repeats: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 3  # repeats, each with other noise
    seed: Annotated[int, Field(ge=0, le=10**12, strict=True)] = 1  # seed of the first repeat
    model: str | None = None  # model to fit; default: the model of the object's law
    robot: str = "follower"
    scenario: str | dict[str, Any] = "default"  # all other settings of the simulated world
    plan: Mapping[str, Any] = Field(default_factory=dict)  # further keys of the probing plan

    @field_validator("speeds_mm_s", mode="before")
    @classmethod
    def _list_runs(cls, value: object) -> object:
        if isinstance(value, list | tuple) and any(isinstance(speed, int | float) for speed in value):
            speeds = ", ".join(map(str, value))
            each = ", ".join(f"[{speed}]" for speed in value)
            raise PydanticCustomError(
                "no_runs",
                "give a list of speeds for each probing run: [[{speeds}]] for one run with all these speeds, "
                "[{each}] for a run at each speed",
                {"speeds": speeds, "each": each},
            )
        return value

    @field_validator("estimators")
    @classmethod
    def _check_estimators(cls, value: str | tuple[Spec, ...]) -> str | tuple[Spec, ...]:
        for spec in () if value == ALL else (value,) if isinstance(value, str) else value:
            make_estimator(spec)
        return value

    @field_validator("model")
    @classmethod
    def _check_model(cls, value: str | None) -> str | None:
        return None if value is None else MODELS[value].name

    @model_validator(mode="after")
    def _check_worlds(self) -> "GridFile":
        rate_hz = find_robot(self.robot).control_rate_hz
        laws = self.laws()
        for law in laws:
            world(self._parameters(law, self.speeds_mm_s[0], 0.0, 0.0, NOTHING), self.seed)
        for number, hidden in enumerate(self.hidden):
            try:
                world(self._parameters(laws[0], self.speeds_mm_s[0], 0.0, 0.0, hidden), self.seed)
            except InputError as error:
                raise problem_at(f"hidden.{number}", str(error)) from error
        for speeds in self.speeds_mm_s:
            check_duration(validate(ProbingPlan, self._plan(speeds)), rate_hz)
        return self

    def laws(self) -> list[dict[str, Any]]:
        """Return all objects' laws with their parameters; raise `InputError` if there are too many."""
        given: list[dict[str, list[Any]]] = []
        for entry in self.objects:
            choices: dict[str, list[Any]] = {}
            for name, value in entry.items():
                if isinstance(value, Mapping):
                    choices[name] = validate(ParameterRange, value).values()
                else:
                    choices[name] = list(value) if isinstance(value, list | tuple) else [value]
            given.append(choices)
        if (objects := sum(math.prod(map(len, entry.values())) for entry in given)) > MOST_CASES:
            raise InputError(f"{objects:.3g} objects; at most {MOST_CASES} are allowed")
        if not objects:
            raise InputError("objects: a list or range of numbers is empty")
        return [
            dict(zip(entry, values, strict=True)) for entry in given for values in product(*entry.values())
        ]

    def short_ranges(self) -> Iterator[str]:
        """Yield a sentence on each range whose last number is not its end."""
        for name, value in (item for entry in self.objects for item in entry.items()):
            if isinstance(value, Mapping):
                given = validate(ParameterRange, value)
                last, step = given.values()[-1], given.step
                if not math.isclose(last, given.to, abs_tol=1e-6 * step):
                    yield (
                        f"{name}: steps of {step:g} from {given.from_:g} end at {last:g} and do not reach "
                        f"{given.to:g}"
                    )

    def cases(self) -> Iterator[Case]:
        """Yield all combinations for each repeat, so that an interrupted sweep covers all of them."""
        task = DIAGNOSE if self.diagnose else ESTIMATE
        axes = self.laws(), self.speeds_mm_s, self.noise_std_n, self.noise_percent, self.hidden
        for repeat in range(self.repeats):
            for values in product(*axes):
                yield Case(task, self._parameters(*values), self.seed + repeat)

    def _parameters(
        self, law: Mapping[str, Any], speeds: tuple[float, ...], std_n: float, percent: float, hidden: Hidden
    ) -> dict[str, Any]:
        model = self.model or ("hunt_crossley" if law.get("name") == HuntCrossleyLaw.name else "kelvin_voigt")
        named = [self.estimators] if isinstance(self.estimators, str) else list(self.estimators)
        if self.estimators == ALL:
            named = [*ESTIMATORS, *(name for name, each in CONTACT_ESTIMATORS.items() if each.model == model)]
        return {
            "robot": self.robot,
            "scenario": self.scenario,
            "law": law,
            "plan": self._plan(speeds),
            "noise_std_n": std_n,
            "noise_percent": percent,
            "hidden": hidden,
            "draws": self.draws if percent else 1,
            "model": model,
            "estimators": named,
        }

    def _plan(self, speeds: tuple[float, ...]) -> dict[str, Any]:
        return dict(self.plan) | {"speeds_m_s": [_MILLI * speed for speed in speeds]}


def load_grid(path: Path) -> GridFile:
    """Read the file of a sweep; an `InputError` names file, line, key and valid choices.

    Args:
        path: YAML file.
    """
    grid = GridFile.load(path)
    lists = (grid.laws(), grid.speeds_mm_s, grid.noise_std_n, grid.noise_percent, grid.hidden)
    count = grid.repeats * math.prod(map(len, lists))  # Python's int does not overflow
    if count > MOST_CASES:
        raise InputError(f"{path}: {count} cases; at most {MOST_CASES}")
    return grid
