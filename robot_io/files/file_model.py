"""Validation of user files, with errors that name file, line, key, value and valid values."""

import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from robot_io.errors import InputError
from robot_io.files.safe_yaml import KeyPath, YamlDocument, one_line
from robot_io.registry import Registry

_MAX_SHOWN = 60  # characters of a value in an error


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool | str):
        raise PydanticCustomError("not_a_number", "expected a number")
    return value


Number = Annotated[float, BeforeValidator(_refuse_boolean), Field(allow_inf_nan=False)]
"""A finite number that was written as a number: `true` is not 1."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]


def matching(pattern: str, words: str) -> AfterValidator:
    """Make a validator for text that must match a pattern as a whole.

    Args:
        pattern: regular expression.
        words: description of valid text, after "give ".

    Returns:
        The validator.
    """
    compiled = re.compile(pattern)

    def check(text: str) -> str:
        if not compiled.fullmatch(text):
            raise PydanticCustomError("no_match", "give {words}", {"words": words})
        return text

    return AfterValidator(check)


def between(low: float, high: float, unit: str) -> AfterValidator:
    """Make a validator for a number within bounds.

    Args:
        low: lower bound.
        high: upper bound.
        unit: of the number.

    Returns:
        The validator.
    """

    def check(value: float) -> float:
        if not low <= value <= high:
            raise PydanticCustomError("outside", "give {words}", {"words": f"{low:g} to {high:g} {unit}"})
        return value

    return AfterValidator(check)


ZeroAngle = Annotated[Number, between(-25.0, 25.0, "rad")]
"""A joint angle where its drive shows zero: four turns at most, more than a drive counts from power-up."""

Capacity = Annotated[Positive, Field(le=1e5)]
"""Where a force sensor's range ends [N]; no arm carries a larger one."""
TorqueConstant = Annotated[Number, between(1e-3, 100.0, "N m/A")]
"""Torque of a motor, or behind its gear, for its current [N m/A]."""


def problem_at(key: str, text: str) -> PydanticCustomError:
    """Make an error of a model about a key below it, whose line the message then names.

    Args:
        key: such as `values.scale`.
        text: the problem.

    Returns:
        The error, to be raised in a validator.
    """
    return PydanticCustomError("problem_at", "{text}", {"text": text, "key": key})


class FileModel(BaseModel):
    """Base of everything that is read from a file: frozen; an unknown key is an error with a hint."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _know_every_key(cls, data: object) -> object:
        if isinstance(data, Mapping) and cls.model_config.get("extra") == "forbid":
            valid = {field.alias or name for name, field in cls.model_fields.items()}
            for key in data:
                if key not in valid:
                    raise _unknown_key(str(key), sorted(valid))
        return data


Model = TypeVar("Model", bound=BaseModel)


def _unknown_key(key: str, valid: list[str]) -> PydanticCustomError:
    close = get_close_matches(key, valid, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else "."
    # The texts travel in the context: braces in a key must not be read as a template.
    context = {"key": key[:_MAX_SHOWN], "hint": hint, "valid": ", ".join(valid)}
    return PydanticCustomError("unknown_key", "is not known{hint} Valid: {valid}", context)


def validate(
    model: type[Model], data: object, document: YamlDocument | None = None, at: KeyPath = ()
) -> Model:
    """Make a model from data.

    Args:
        model: class of the model.
        data: to validate.
        document: YAML that holds the data; None for data made by a program.
        at: path of the data in the document.

    Returns:
        The model.

    Raises:
        InputError: the first problem with file and line, and the number of further ones.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(_describe(problems[0], document, at) + more) from error


def member(value: object, registry: Registry[Model], key: str) -> Model:
    """Make a registry's member from `{key: its name, parameter: ...}`; return a finished member as it is.

    Args:
        value: mapping, or member.
        registry: of the members.
        key: that holds the name.

    Returns:
        The member.

    Raises:
        InputError: no such member, no name given, or a parameter is unknown, missing or outside its range.
    """
    if isinstance(value, registry.base):
        return value
    if not isinstance(value, Mapping) or not isinstance(value.get(key), str):
        valid = ", ".join(registry)
        raise InputError(f"a {registry.kind} is a mapping with '{key}' and parameters. Valid: {valid}")
    return validate(registry[value[key]], {name: entry for name, entry in value.items() if name != key})


def input_error(
    document: YamlDocument | None, key_path: KeyPath, problem: str, value: object = None
) -> InputError:
    """Make the error for a place in a document: file, line, key, problem and value.

    Problems of the whole file, or of a key that is missing, have no line.

    Args:
        document: YAML, or None.
        key_path: path of the key.
        problem: description.
        value: that is wrong, if any.

    Returns:
        The error, to be raised.
    """
    places = [_place(document, key_path)] if document else []
    places += [_key_text(key_path)] if key_path else []
    shown = "" if value is None else f" (is {_shorten(repr(value))})"
    return InputError(one_line(": ".join(filter(None, (", ".join(places), f"{problem}{shown}")))))


def _place(document: YamlDocument, key_path: KeyPath) -> str:
    has_line = key_path[:1] in document.lines and key_path
    return f"{document.origin} line {document.line_of(key_path)}" if has_line else document.origin


def _key_text(key_path: KeyPath) -> str:
    """Write a path such as `limits.torque_nm entry 3`; a key that is not a plain word is quoted."""
    text = ""
    for key in key_path:
        if isinstance(key, int):
            text += f" entry {key + 1}"
        else:
            text += ("." if text else "") + (key if key.isidentifier() else repr(key))
    return text[:200]


def _describe(problem: Any, document: YamlDocument | None, at: KeyPath) -> str:  # noqa: ANN401 (pydantic's dict)
    key_path: KeyPath = (*at, *problem["loc"])
    if problem["type"] == "unknown_key":
        return str(input_error(document, (*key_path, problem["ctx"]["key"]), problem["msg"]))
    if problem["type"] == "problem_at":
        return str(input_error(document, (*key_path, *problem["ctx"]["key"].split(".")), problem["msg"]))
    if problem["type"] == "missing":
        return str(input_error(document, key_path, "is missing"))
    message = str(problem["msg"]).removeprefix("Value error, ")
    value = problem["input"] if not isinstance(problem["input"], Mapping | BaseModel) else None
    return str(input_error(document, key_path, message[:1].lower() + message[1:], value))


def _shorten(text: str) -> str:
    return text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 4] + " ..."
