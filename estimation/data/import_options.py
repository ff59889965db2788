"""Options for reading a data file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from palpate.robot_io.errors import InputError


@dataclass(frozen=True)
class ImportOptions:
    """Options for reading a data file. Raises InputError if one of them has another type."""

    # Column for each quantity that is called something else, such as {"force_N": "load"}.
    columns: Mapping[str, str] = field(default_factory=dict)
    # Unit of a quantity or of a column where the name does not say it, such as {"force": "mN"}.
    units: Mapping[str, str] = field(default_factory=dict)
    # Only rows in which a column has this text, such as {"specimen": "P002"}.
    where: Mapping[str, str] = field(default_factory=dict)
    context: tuple[str, ...] = ()  # further columns of numbers to keep beside the channels
    # Each run met an object, or a spot of it, that was never pressed before, on whatever clock.
    fresh: bool = False
    runs: int | None = None  # how many presses the recording holds; None to find them

    table: str = ""  # sheet, or line of the header, of another table than the file's longest

    def __post_init__(self) -> None:
        for name, example in _PAIRS.items():
            pairs = getattr(self, name)
            texts = [*pairs, *pairs.values()] if isinstance(pairs, Mapping) else [None]
            if not all(isinstance(text, str) for text in texts):
                raise InputError(f"{name}={pairs!r}: give a dict of texts, such as {example}")
        if not (isinstance(self.context, tuple) and all(isinstance(text, str) for text in self.context)):
            raise InputError(
                f"context={self.context!r}: give a list of column names, such as ['temperature']"
            )
        if not (self.runs is None or (isinstance(self.runs, int) and self.runs > 0)):
            raise InputError(f"runs={self.runs!r}: give the number of presses, such as 4")
        if not isinstance(self.table, str):
            raise InputError(
                f"table={self.table!r}: give the title of a sheet, or the header's line, as text"
            )


_PAIRS = {"columns": "{'force_N': 'load'}", "units": "{'force': 'mN'}", "where": "{'specimen': 'P002'}"}


def parse_pairs(texts: Iterable[str], option: str) -> dict[str, str]:
    """Read options of the form NAME=VALUE.

    Args:
        texts: texts as the user wrote them.
        option: option by which they were given, such as "--unit".

    Raises:
        InputError: one of them has another form, or a name comes twice.
    """
    pairs: dict[str, str] = {}
    for text in texts:
        # a column's name may hold the sign, and no unit does
        name, equals, value = text.rpartition("=") if option == "--unit" else text.partition("=")
        name, value = name.strip(), value.strip()
        if not (equals and name and value):
            raise InputError(f"{option} '{text}': write it as NAME=VALUE")
        if name in pairs:
            raise InputError(f"{option} '{name}' is given twice: '{pairs[name]}' and '{value}'")
        pairs[name] = value
    return pairs
