"""Foreign YAML files as models: bounded and strict, with file, line and key in every error.

A small subset of YAML: mappings, lists and plain values as in YAML 1.2 (only `true` and `false` are booleans,
`1e3` is a number, dates stay text). Duplicate keys, anchors, aliases and tags are refused, so that a file is
unambiguous and cannot grow when it is read.
"""

import errno
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar, cast

import yaml
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

from palpate.robot_io.errors import InputError, one_line
from palpate.robot_io.registry import Registry

MAX_YAML_BYTES = 256 * 1024
MAX_DEPTH = 20

KeyPath = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class YamlDocument:
    """One parsed YAML file."""

    origin: str  # name of the file, for errors
    text: str  # the file as it was written
    data: dict[str, object]  # the top-level mapping; keys are strings
    # Line (from 1) of every key and list entry, by its path such as `("limits", "force_n")`.
    lines: Mapping[KeyPath, int]

    def line_of(self, key_path: KeyPath) -> int:
        """Find the line, from 1, of a key or of the nearest existing part of its path.

        Args:
            key_path: keys and list indices from the top level of the document; line 1 if none exists.
        """
        while key_path and key_path not in self.lines:
            key_path = key_path[:-1]
        return self.lines.get(key_path, 1)


def load_yaml(path: str | Path, max_bytes: int = MAX_YAML_BYTES) -> YamlDocument:
    """Read a YAML file.

    Args:
        path: path of the file.
        max_bytes: largest size.

    Raises:
        InputError: the file cannot be read, is too large, is not UTF-8, or is not the strict YAML of this
            module.
    """
    try:
        text = read_text(Path(path), max_bytes)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return parse_yaml(text, str(path))


def parse_yaml(text: str, origin: str, max_bytes: int = MAX_YAML_BYTES) -> YamlDocument:
    """Read YAML from text; raise `InputError` if it is too large, or not the strict YAML of this module.

    Args:
        text: YAML.
        origin: name of the text in errors.
        max_bytes: largest size.
    """
    if len(text) > max_bytes:
        raise InputError(f"{origin}: larger than {max_bytes} bytes, the limit for such a file")
    lines: dict[KeyPath, int] = {}
    try:
        node = _parse_nodes(text)
        data = _build_value(node, (), lines) if node is not None else {}
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise InputError(f"{origin} line {line}: {one_line(error.problem)}") from error
    except yaml.YAMLError as error:
        raise InputError(f"{origin}: {one_line(str(error))}") from error
    if not isinstance(data, dict):
        raise InputError(f"{origin}: begins with '{one_line(text)[:60]}', expected 'key: value' lines")
    return YamlDocument(origin, text, data, lines)


def _parse_nodes(text: str) -> yaml.Node | None:
    """Return the node tree, which callers do not change."""
    return _NodeLoader(text).get_single_node()


class _NodeLoader(yaml.SafeLoader):
    """PyYAML up to the node tree; `_build_value` makes the values, so that no other objects can be made."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]
        for forbidden in ("anchor", "tag"):  # an alias is an event that holds an anchor
            if getattr(event, forbidden, None) is not None:
                raise _marked_error("an anchor (&), alias (*) or tag (!) is not allowed; quote text", event)
        if any("\ud800" <= letter <= "\udfff" for letter in getattr(event, "value", "")):
            raise _marked_error("half of a surrogate pair (\\ud800 to \\udfff) is not a character", event)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise _marked_error(f"nested deeper than {MAX_DEPTH} levels", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _marked_error(problem: str, at: yaml.Event | yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=cast("yaml.error.Mark", at.start_mark))


def _build_value(node: yaml.Node, key_path: KeyPath, lines: dict[KeyPath, int]) -> object:
    """Return the value of `node`, and record the line of each key and list entry in it."""
    lines.setdefault(key_path, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        mapping: dict[str, object] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise _marked_error("a key must be a plain word", key_node)
            key: str = key_node.value
            if key in mapping:
                raise _marked_error(f"the key '{key:.60}' appears twice", key_node)
            lines[(*key_path, key)] = key_node.start_mark.line + 1
            mapping[key] = _build_value(value_node, (*key_path, key), lines)
        return mapping
    if isinstance(node, yaml.SequenceNode):
        return [_build_value(item, (*key_path, index), lines) for index, item in enumerate(node.value)]
    # A plain value by the core schema of YAML 1.2; quoted text stays text.
    text: str = node.value
    if cast("yaml.ScalarNode", node).style is None:
        if text.lower() in _PLAIN_WORDS:
            return _PLAIN_WORDS[text.lower()]
        for pattern, convert in _NUMBERS:
            if pattern.fullmatch(text):
                return convert(text)
    return text


_PLAIN_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}
_NUMBERS: tuple[tuple[re.Pattern[str], Callable[[str], float]], ...] = (
    (re.compile(r"[-+]?[0-9]{1,18}"), int),
    (re.compile(r"0x[0-9a-fA-F]{1,16}"), lambda text: int(text, 16)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
    (re.compile(r"[-+]?\.(inf|nan)", re.IGNORECASE), lambda text: float(text.replace(".", ""))),
)


MAX_TEXT_BYTES = 16 * 1024 * 1024


def read_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Read a text file.

    Args:
        path: path of the file.
        max_bytes: largest size.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is a device or a pipe, is too large, or is not UTF-8.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no file can have this name")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError("a device or a pipe, not a file")
    with path.open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise ValueError(f"larger than {max_bytes} bytes, the limit for such a file")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 text (byte {error.start})") from error


_MAX_SHOWN = 60  # characters of a value in an error


def _expect_number(value: object) -> object:
    if isinstance(value, bool | str):
        raise PydanticCustomError("not_a_number", "expected a number")
    return value


Number = Annotated[float, BeforeValidator(_expect_number), Field(allow_inf_nan=False)]
"""A finite number; `true` and text such as `"1"` are rejected."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]


def matching(pattern: str, words: str) -> AfterValidator:
    """Make a validator for text that must match a pattern as a whole.

    Args:
        pattern: regular expression.
        words: description of valid text, to follow "give ".
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
        unit: unit of the number.
    """

    def check(value: float) -> float:
        if not low <= value <= high:
            raise PydanticCustomError("outside", "give {words}", {"words": f"{low:g} to {high:g} {unit}"})
        return value

    return AfterValidator(check)


ZeroAngle = Annotated[Number, between(-25.0, 25.0, "rad")]
"""Joint angle at which the drive reads zero; a drive reads less than the limit of four turns at power-up."""

Capacity = Annotated[Positive, Field(le=1e5)]
"""Largest force that a force sensor can measure [N]; larger sensors are too heavy for an arm."""
TorqueConstant = Annotated[Number, between(1e-3, 100.0, "N m/A")]
"""Torque per current of a motor, or of a motor with its gear [N m/A]."""


def problem_at(key: str, text: str) -> PydanticCustomError:
    """Make an error, to be raised in a validator, about a key below a model; the message names its line.

    Args:
        key: key, such as `values.scale`, or `hidden.0` for the first entry of a list.
        text: the problem.
    """
    return PydanticCustomError("problem_at", "{text}", {"text": text, "key": key})


class FileModel(BaseModel):
    """Base of everything that is read from a file: frozen; an unknown key is an error with a hint."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def load(cls, source: "str | Path | YamlDocument") -> Self:
        """Read a file of this kind; raise `InputError` with file, line, key and valid values.

        Args:
            source: path of a YAML file, or a document that was read already.
        """
        document = source if isinstance(source, YamlDocument) else load_yaml(source)
        return validate(cls, document.data, document)

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: object) -> object:
        if isinstance(data, Mapping) and cls.model_config.get("extra") == "forbid":
            valid = {field.alias or name for name, field in cls.model_fields.items()}
            for key in data:
                if key not in valid:
                    close = get_close_matches(str(key), sorted(valid), n=1)
                    hint = f"; did you mean '{close[0]}'?" if close else "."
                    # The texts travel in the context: braces in a key must not be read as a template.
                    shown = {"key": str(key)[:_MAX_SHOWN], "hint": hint, "valid": ", ".join(sorted(valid))}
                    raise PydanticCustomError("unknown_key", "is not known{hint} Valid: {valid}", shown)
        return data


Model = TypeVar("Model", bound=BaseModel)


def validate(
    model: type[Model], data: object, document: YamlDocument | None = None, at: KeyPath = ()
) -> Model:
    """Make a model from data; raise `InputError` with the place of the first problem, and how many follow.

    Args:
        model: class of the model.
        data: data to validate.
        document: YAML that holds the data; None for data made by a program.
        at: path of the data in the document.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        problem: Any = problems[0]
        key_path, text, value = (*at, *problem["loc"]), str(problem["msg"]), None
        if problem["type"] == "unknown_key":
            key_path = (*key_path, problem["ctx"]["key"])
        elif problem["type"] == "problem_at":
            keys = problem["ctx"]["key"].split(".")
            key_path = (*key_path, *(int(key) if key.isdecimal() else key for key in keys))
        elif problem["type"] == "missing":
            text = "is missing"
        else:
            text = text.removeprefix("Value error, ")
            text = text[:1].lower() + text[1:].replace("valid tuple", "list, such as [1, 2]")
            value = problem["input"] if not isinstance(problem["input"], Mapping | BaseModel) else None
        raise InputError(f"{input_error(document, key_path, text, value)}{more}") from error


def member(value: object, registry: Registry[Model], key: str) -> Model:
    """Make a registry's member from `{key: its name, parameter: ...}`; return a finished member as it is.

    Args:
        value: mapping, or member.
        registry: registry of the members.
        key: key of the member's name.

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
        document: YAML document, or None.
        key_path: path of the key.
        problem: description.
        value: value that is wrong, if any.
    """
    places = [document.origin] if document else []
    if document and key_path and key_path[:1] in document.lines:
        places = [f"{document.origin} line {document.line_of(key_path)}"]
    if key_path:  # such as `limits.torque_nm entry 3`; a key that is not a plain word is quoted
        words = (
            f" entry {key + 1}" if isinstance(key, int) else f".{key if key.isidentifier() else repr(key)}"
            for key in key_path
        )
        places.append("".join(words).removeprefix(".")[:200])
    if value is not None:
        shown = repr(value)
        problem += f" (is {shown if len(shown) <= _MAX_SHOWN else shown[: _MAX_SHOWN - 4] + ' ...'})"
    return InputError(one_line(": ".join(filter(None, (", ".join(places), problem)))))
