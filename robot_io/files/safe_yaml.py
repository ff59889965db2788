"""Reading of foreign YAML files: bounded, strict, and with the line of every key.

A small subset of YAML: mappings, lists and plain values as in YAML 1.2 (only `true` and `false` are booleans,
`1e3` is a number, dates stay text). Duplicate keys, anchors, aliases and tags are refused, so that a file is
unambiguous and cannot grow when it is read.
"""

import errno
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import yaml

from robot_io.errors import InputError

MAX_BYTES = 256 * 1024
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
        """Find the line of a key, or of the nearest existing part of its path.

        Args:
            key_path: path of the key.

        Returns:
            Line from 1.
        """
        while key_path and key_path not in self.lines:
            key_path = key_path[:-1]
        return self.lines.get(key_path, 1)


def load_yaml(path: str | Path, max_bytes: int = MAX_BYTES) -> YamlDocument:
    """Read a YAML file.

    Args:
        path: of the file.
        max_bytes: largest size.

    Returns:
        The document.

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


def parse_yaml(text: str, origin: str, max_bytes: int = MAX_BYTES) -> YamlDocument:
    """Read YAML from text.

    Args:
        text: YAML.
        origin: name of the text in errors.
        max_bytes: largest size.

    Returns:
        The document.

    Raises:
        InputError: the text is too large, or not the strict YAML of this module.
    """
    if len(text) > max_bytes:
        raise InputError(f"{origin}: larger than {max_bytes} bytes, which no such file needs to be")
    lines: dict[KeyPath, int] = {}
    try:
        node = _composed(text)
        data = _value(node, (), lines) if node is not None else {}
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise InputError(f"{origin} line {line}: {one_line(error.problem)}") from error
    except yaml.YAMLError as error:
        raise InputError(f"{origin}: {one_line(str(error))}") from error
    if not isinstance(data, dict):
        raise InputError(f"{origin}: begins with '{one_line(text)[:60]}', expected 'key: value' lines")
    return YamlDocument(origin, text, data, lines)


def _composed(text: str) -> yaml.Node | None:
    """The node tree; nothing below changes it."""
    return _Composer(text).get_single_node()


class _Composer(yaml.SafeLoader):
    """PyYAML up to the node tree; values are made by `_value`, so that nothing else can be constructed."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]
        for forbidden in ("anchor", "tag"):  # an alias is an event that holds an anchor
            if getattr(event, forbidden, None) is not None:
                raise _error("an anchor (&), alias (*) or tag (!) is not allowed; quote text", event)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise _error(f"nested deeper than {MAX_DEPTH} levels", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _error(problem: str, at: yaml.Event | yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=cast("yaml.error.Mark", at.start_mark))


def _value(node: yaml.Node, key_path: KeyPath, lines: dict[KeyPath, int]) -> object:
    """The value of `node`; records the line of everything inside it."""
    lines.setdefault(key_path, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        return _mapping(node, key_path, lines)
    if isinstance(node, yaml.SequenceNode):
        return [_value(item, (*key_path, index), lines) for index, item in enumerate(node.value)]
    return _scalar(cast("yaml.ScalarNode", node))


def _mapping(node: yaml.MappingNode, key_path: KeyPath, lines: dict[KeyPath, int]) -> dict[str, object]:
    mapping: dict[str, object] = {}
    for key_node, value_node in node.value:
        if not isinstance(key_node, yaml.ScalarNode):
            raise _error("a key must be a plain word", key_node)
        key: str = key_node.value
        if key in mapping:
            raise _error(f"the key '{key:.60}' appears twice", key_node)
        lines[(*key_path, key)] = key_node.start_mark.line + 1
        mapping[key] = _value(value_node, (*key_path, key), lines)
    return mapping


_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}
_NUMBERS: tuple[tuple[re.Pattern[str], Callable[[str], float]], ...] = (
    (re.compile(r"[-+]?[0-9]{1,18}"), int),
    (re.compile(r"0x[0-9a-fA-F]{1,16}"), lambda text: int(text, 16)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
    (re.compile(r"[-+]?\.(inf|nan)", re.IGNORECASE), lambda text: float(text.replace(".", ""))),
)


def _scalar(node: yaml.ScalarNode) -> object:
    """A plain value by the core schema of YAML 1.2; quoted text stays text."""
    text: str = node.value
    if node.style is not None:
        return text
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for pattern, convert in _NUMBERS:
        if pattern.fullmatch(text):
            return convert(text)
    return text


def one_line(text: object) -> str:
    """Write foreign text for a message: one line, without control characters.

    Args:
        text: anything.

    Returns:
        Printable text.
    """
    return "".join(char if char.isprintable() else "?" for char in " ".join(str(text).split()))


MOST_BYTES = 16 * 1024 * 1024


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Read a text file.

    Args:
        path: of the file.
        most_bytes: largest size.

    Returns:
        The text.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is a device or a pipe, is too large, or is not UTF-8.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no file has such a name")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError("a device or a pipe, not a file")
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise ValueError(f"larger than {most_bytes} bytes, which no such file needs to be")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 text (byte {error.start})") from error
