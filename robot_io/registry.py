"""Registry of implementations by name; a new implementation needs one new file in the right folder."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from functools import cache, cached_property
from types import ModuleType
from typing import Generic, TypeVar, cast

from palpate.robot_io.errors import InputError, UnknownNameError

T = TypeVar("T")


class Registry(Mapping[str, type[T]], Generic[T]):
    """Every concrete subclass of a base class in some packages, by its class attribute `name`.

    Args:
        kind: name of a member in errors, such as "driver".
        base: base class of the members.
        packages: dotted names of packages or modules; searched with their subpackages, on first use.
    """

    def __init__(self, kind: str, base: type[T], *packages: str) -> None:
        self.kind = kind
        self.base = base
        self._packages = packages

    @cached_property
    def _members(self) -> dict[str, type[T]]:
        members: dict[str, type[T]] = {}
        for package in map(importlib.import_module, self._packages):
            for member in cast("tuple[type[T], ...]", _members_in(package, self.base)):  # type: ignore[arg-type]
                name = vars(member)["name"]
                if name in members:
                    raise InputError(f"two {self.kind}s are called '{name}': {members[name]} and {member}")
                members[name] = member
        return dict(sorted(members.items()))

    def __getitem__(self, name: str) -> type[T]:
        try:
            return self._members[name]
        except KeyError:
            raise UnknownNameError(self.unknown(name)) from None

    def unknown(self, name: str) -> str:
        """Describe an unknown name, with the closest and all valid ones.

        Args:
            name: the unknown name; a single valid name that contains it counts as the closest.
        """
        having = [member for member in self._members if str(name) and str(name) in member]  # such as "cubic"
        close = having if len(having) == 1 else get_close_matches(str(name), self._members, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else "."
        valid = ", ".join(self._members) or "(none found)"
        return f"no {self.kind} is called '{name}'{hint} Valid: {valid}"

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)

    def __contains__(self, name: object) -> bool:
        return name in self._members


@cache
def _members_in(package: ModuleType, base: type[object]) -> tuple[type[object], ...]:
    """Return the members defined in a package's own modules; classes without a `name` are base classes."""
    inside = pkgutil.walk_packages(getattr(package, "__path__", ()), package.__name__ + ".")
    modules = (package, *(importlib.import_module(entry.name) for entry in inside))
    return tuple(
        value
        for module in modules
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, base) and value.__module__ == module.__name__
        if isinstance(vars(value).get("name"), str) and not inspect.isabstract(value)
    )
