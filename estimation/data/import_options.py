"""Options for reading a data file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from palpate.robot_io.errors import InputError

_EXAMPLES = {"columns": "{'force_N': 'load'}", "units": "{'force': 'mN'}", "where": "{'specimen': 'P002'}"}


@dataclass(frozen=True)
class ImportOptions:
    """Options for reading a data file.

    Raises:
        InputError: an option has a wrong type.
    """

    # Column name by quantity, if the names are not palpate's own, such as {"force_N": "load"}.
    columns: Mapping[str, str] = field(default_factory=dict)
    # Unit by quantity or column, if the column name does not state it, such as {"force": "mN"}.
    units: Mapping[str, str] = field(default_factory=dict)
    # Text that a column must have in the rows to read, such as {"specimen": "P002"}.
    where: Mapping[str, str] = field(default_factory=dict)
    context: tuple[str, ...] = ()  # additional numeric columns to keep as context of the channels
    # Whether each run pressed a new object or a new spot, even if the clock continues across runs.
    fresh: bool = False
    runs: int | None = None  # number of presses in the recording; None to detect them
    table: str = ""  # sheet or header line of the table to read; empty for the longest table
    # Names of the arm's joints from the base outwards, by which columns are numbered; not stated by the user.
    joint_names: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        for name, example in _EXAMPLES.items():
            pairs = getattr(self, name)
            texts = [*pairs, *pairs.values()] if isinstance(pairs, Mapping) else [None]
            if not all(isinstance(text, str) for text in texts):
                raise InputError(
                    f"{name}={pairs!r}: give a dict of strings (numbers in quotes), such as {example}"
                )
        if not (isinstance(self.context, tuple) and all(isinstance(text, str) for text in self.context)):
            raise InputError(f"context={self.context!r}: give a list of columns, such as ['temperature']")
        if not isinstance(self.fresh, bool):
            raise InputError(f"fresh={self.fresh!r}: give True or False")
        if not (self.runs is None or (isinstance(self.runs, int) and self.runs > 0)):
            raise InputError(f"runs={self.runs!r}: give the number of presses, such as 4")
        if not isinstance(self.table, str):
            raise InputError(f"table={self.table!r}: give a sheet's title, or the header's line, as text")

    def stated(self) -> dict[str, Any]:
        """Return the options that a user may state, by name."""
        return {name: value for name, value in vars(self).items() if name != "joint_names"}


NO_OPTIONS = ImportOptions()


def parse_pairs(texts: Iterable[str], option: str) -> dict[str, str]:
    """Parse options of the form NAME=VALUE.

    Args:
        texts: texts as the user wrote them.
        option: name of the option, such as "--unit".

    Raises:
        InputError: a text does not have this form, or a name occurs twice.
    """
    pairs: dict[str, str] = {}
    for text in texts:
        # A column name may contain "=", a unit does not.
        name, equals, value = text.rpartition("=") if option == "--unit" else text.partition("=")
        name, value = name.strip(), value.strip()
        if not (equals and name and value):
            raise InputError(f"{option} '{text}': write it as NAME=VALUE")
        if name in pairs:
            raise InputError(f"{option} '{name}' is given twice: '{pairs[name]}' and '{value}'")
        pairs[name] = value
    return pairs
