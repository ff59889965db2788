"""The scenario file: properties of the simulated world that the robot does not know."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

import yaml
from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import FileModel, Number, validate
from palpate.sim_backend.contact_laws import ObjectLaw, parse_contact_law
from palpate.sim_backend.contact_laws.standard import EngineContact, KelvinVoigtLaw
from palpate.sim_backend.engines import EngineName, default_engine
from palpate.sim_backend.imperfection import Imperfection, parse_imperfection
from palpate.sim_backend.sensors import ArmSensorSettings

SHIPPED_DIR = Path(__file__).parent / "scenarios"
MOST_SEED = 10**18 - 1  # the longest whole number that the YAML reader takes

Law = Annotated[ObjectLaw, BeforeValidator(parse_contact_law), PlainSerializer(ObjectLaw.describe)]
Hidden = Annotated[Imperfection, BeforeValidator(parse_imperfection), PlainSerializer(Imperfection.describe)]


class ObjectSettings(FileModel):
    """The compliance object: a flat surface, as wide as the arm reaches, pressed downwards."""

    surface_height_m: Number = 0.05  # world height of the undeformed surface [m]
    law: Law = KelvinVoigtLaw(stiffness_n_m=500.0, damping_n_s_m=20.0)  # contact law with its parameters


class ArmSettings(FileModel):
    """Differences of the arm from its URDF, and properties that the URDF lacks."""

    mass_scale: Number = Field(default=1.0, gt=0, le=100)  # factor on all masses and inertias [-]
    # Radius of the sphere that touches the engine's own contact [m].
    tip_radius_m: Number = Field(default=0.008, gt=0, le=0.5)


class PhysicsSettings(FileModel):
    """How the physics is integrated."""

    # Physics engine; by default PyBullet if it is installed.
    engine: EngineName = Field(default_factory=default_engine)
    # Steps per second [Hz]; four in a tick of 1 kHz by default.
    rate_hz: Number = Field(default=4000.0, ge=100, le=1e6)
    gravity_m_s2: Number = 9.81  # fall acceleration, downwards [m/s^2]


class Scenario(FileModel):
    """One simulated world; defaults are those of `scenarios/default.yaml`."""

    description: str = ""  # one line for people
    # Of all noise; equal seeds give equal measurements.
    seed: int = Field(default=1, ge=0, le=MOST_SEED, strict=True)
    object: ObjectSettings = ObjectSettings()  # the probed object
    arm: ArmSettings = ArmSettings()  # the arm's deviations
    sensors: ArmSensorSettings = ArmSensorSettings()  # how the robot perceives it
    physics: PhysicsSettings = Field(default_factory=PhysicsSettings)  # how it is integrated
    # Effects that the robot's models do not know, from drives to links and from object to tip.
    hidden: Annotated[tuple[Hidden, ...], Field(max_length=100)] = ()

    @model_validator(mode="after")
    def _check_engine_contact(self) -> Self:
        if isinstance(self.object.law, EngineContact):
            moved = [entry.name for entry in self.hidden if entry.needs_force_law]
            if moved:
                raise ValueError(f"hidden effect '{moved[0]}' needs a force law, not the engine's contact")
        return self

    def public_yaml(self) -> str:
        """Write the scenario without the hidden effects."""
        return _yaml(self.model_dump(mode="json", exclude={"hidden"}))

    def with_hidden(self, hidden: Sequence[Imperfection]) -> Self:
        """Copy the scenario with other hidden effects.

        Args:
            hidden: replace the present ones.

        Raises:
            InputError: they do not fit the scenario.
        """
        return validate(type(self), self.model_dump() | {"hidden": tuple(hidden)})

    def with_seed(self, seed: int) -> Self:
        """Copy the scenario with another seed.

        Args:
            seed: seed of all noise.

        Raises:
            InputError: the seed is invalid.
        """
        return validate(type(self), self.model_dump() | {"hidden": self.hidden, "seed": seed})

    def with_engine(self, engine: EngineName) -> Self:
        """Copy the scenario with another physics engine.

        Args:
            engine: name of the engine.
        """
        return self.model_copy(update={"physics": self.physics.model_copy(update={"engine": engine})})

    def to_yaml(self) -> str:
        """Write the whole scenario, defaults included, in the form that `parse_scenario` reads."""
        return _yaml(self.model_dump(mode="json"))


def _yaml(data: dict[str, object]) -> str:
    text: str = yaml.safe_dump(data, sort_keys=False)
    return text


def shipped_scenarios() -> list[str]:
    """List the names of the scenarios that come with palpate."""
    return sorted(path.stem for path in SHIPPED_DIR.glob("*.yaml"))


def load_scenario(source: object, base_dir: str | Path = ".") -> Scenario:
    """Make a scenario from the name of a shipped one, the path of a YAML file, or a mapping.

    Args:
        source: such as "stiff", "my_object.yaml" or `{object: {...}}`; a scenario is returned as it is.
        base_dir: folder of relative paths.

    Raises:
        InputError: the first problem, with file, line, key and valid values.
    """
    if isinstance(source, Scenario):
        return source
    if isinstance(source, Mapping):
        return validate(Scenario, dict(source))
    if not isinstance(source, str | Path):
        raise InputError(f"a scenario is a name, a path or a mapping (is {source!r:.60})")
    is_shipped = str(source) in shipped_scenarios()
    path = SHIPPED_DIR / f"{source}.yaml" if is_shipped else Path(base_dir) / source
    if not path.is_file():
        shipped = ", ".join(shipped_scenarios())
        raise InputError(f"no scenario '{source}': no such file ({path}). Shipped scenarios: {shipped}")
    return Scenario.load(path)
