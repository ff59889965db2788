"""Names that a shell completes; what knows them is imported only when it asks: help should not wait."""

from pathlib import Path

_YAML = ("*.yaml", "*.yml")


def effect_names() -> list[str]:
    """All effects of the library."""
    from estimation.effects import EFFECTS  # noqa: PLC0415

    return list(EFFECTS)


def estimator_names() -> list[str]:
    """All estimators."""
    from estimation.estimators import ESTIMATORS  # noqa: PLC0415
    from estimation.study.estimates import ALL  # noqa: PLC0415

    return [ALL, *ESTIMATORS]


def model_names() -> list[str]:
    """All base models."""
    from estimation.models import MODELS  # noqa: PLC0415

    return list(MODELS)


def scenario_names() -> list[str]:
    """The shipped worlds, and files of one's own."""
    from sim_backend.scenario import shipped_scenarios  # noqa: PLC0415

    return [*shipped_scenarios(), *own_files()]


def own_files() -> list[str]:
    """The YAML files of the current folder."""
    return sorted(path.name for pattern in _YAML for path in Path().glob(pattern))
