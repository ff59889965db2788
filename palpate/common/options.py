"""Options that several commands share, and the names for shell completion.

Each field of a dataclass is an option with typer's annotation. Modules for completion are imported only when
the shell asks for a completion, so that help starts fast.
"""

import functools
from collections.abc import Callable
from dataclasses import MISSING, fields
from inspect import Parameter, Signature, get_annotations, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from typer import Option


def effect_names() -> list[str]:
    """Return the names of all effects of the library."""
    from palpate.estimation.effects import EFFECTS  # noqa: PLC0415

    return list(EFFECTS)


_ADD = "Effect to fit to every measurement; may be repeated."
AddOption = Annotated[list[str] | None, Option(help=_ADD, metavar="EFFECT", autocompletion=effect_names)]
_PATTERN = "Pattern of the file names, whose parts become fields, such as '{specimen}_{day}.csv'."
PatternOption = Annotated[str | None, Option(help=_PATTERN)]
_WORKERS = "Number of processes on this machine; default: one per core."
WorkersOption = Annotated[int | None, Option(help=_WORKERS, min=1, max=1000)]
_SCHEDULER = "Run on the workers of this dask scheduler."
SchedulerOption = Annotated[str | None, Option(help=_SCHEDULER, metavar="ADDRESS")]
JsonOption = Annotated[bool, Option("--json", help="Print the result as JSON.")]
_SESSION_OUT = "Session file to write; default: a new one in sessions/."
SessionOutOption = Annotated[Path | None, Option("--out", "-o", help=_SESSION_OUT)]
_KEYWORD, _NONE = Parameter.KEYWORD_ONLY, Parameter.empty


def with_options(
    options: type, lead: str = "", **defaults: object
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command one option for each field of `options`, passed as its first argument.

    Args:
        options: dataclass whose fields are the options.
        lead: field placed first. The other fields of the class that declares it come last; fields of a
            derived class and the command's own options come before them. By default all fields come first.
        defaults: default values of fields that differ from those of the class.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        hints = get_type_hints(options, include_extras=True)
        owner = next((each for each in options.__mro__ if lead in get_annotations(each)), None)
        last = {field.name for field in fields(owner)} - {lead} if owner is not None else set()
        shared: dict[str, Parameter] = {}
        for field in fields(options):
            default = defaults.get(field.name, field.default)
            default = _NONE if default is MISSING else default
            shared[field.name] = Parameter(
                field.name, _KEYWORD, default=default, annotation=hints[field.name]
            )
        own = [
            parameter.replace(kind=_KEYWORD) for parameter in list(signature(command).parameters.values())[1:]
        ]

        @functools.wraps(command)
        def call(**values: Any) -> None:  # noqa: ANN401
            command(options(**{name: values.pop(name) for name in shared}), **values)

        names = sorted(shared, key=lambda name: name != lead)
        first = [shared[name] for name in names if name not in last]
        every = [*first, *own, *(shared[name] for name in names if name in last)]
        call.__signature__ = Signature(every)  # type: ignore[attr-defined]
        call.__annotations__ = {parameter.name: parameter.annotation for parameter in every}
        return call

    return decorate


_YAML = ("*.yaml", "*.yml")


def estimator_names() -> list[str]:
    """Return the names of all estimators."""
    from palpate.estimation.estimators import ESTIMATORS  # noqa: PLC0415
    from palpate.estimation.study.estimates import ALL  # noqa: PLC0415

    return [ALL, *ESTIMATORS]


def model_names() -> list[str]:
    """Return the names of all base models."""
    from palpate.estimation.models import MODELS  # noqa: PLC0415

    return list(MODELS)


def scenario_names() -> list[str]:
    """Return the shipped scenarios, and the user's own files."""
    from palpate.sim_backend.scenario import shipped_scenarios  # noqa: PLC0415

    return [*shipped_scenarios(), *yaml_files()]


def yaml_files() -> list[str]:
    """Return the YAML files of the current folder."""
    return sorted(path.name for pattern in _YAML for path in Path().glob(pattern))
