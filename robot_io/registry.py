"""Finds implementations by name: a new one is one new file in the right folder, and nothing else is touched."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from functools import cached_property
from typing import Generic, TypeVar

from robot_io.errors import InputError

T = TypeVar("T")


class Registry(Mapping[str, type[T]], Generic[T]):
    """Every concrete subclass of `base` in the modules of `packages`, by its class attribute `name`.

    Args:
        kind: what to call a member in errors, such as "driver".
        base: the class that members derive from; each states a `name`.
        packages: dotted names of the packages whose modules are searched, on first use.
    """

    def __init__(self, kind: str, base: type[T], *packages: str) -> None:
        self.kind = kind
        self._base = base
        self._packages = packages

    @cached_property
    def _members(self) -> dict[str, type[T]]:
        found: dict[str, type[T]] = {}
        for package_name in self._packages:
            package = importlib.import_module(package_name)
            for module_info in pkgutil.iter_modules(package.__path__, package_name + "."):
                module = importlib.import_module(module_info.name)
                for member in self._defined_in(module.__name__, vars(module)):
                    name = vars(member)["name"]
                    if name in found:
                        raise InputError(f"two {self.kind}s are called '{name}': {found[name]} and {member}")
                    found[name] = member
        return dict(sorted(found.items()))

    def _defined_in(self, module_name: str, namespace: Mapping[str, object]) -> Iterator[type[T]]:
        for value in namespace.values():
            is_member = (
                inspect.isclass(value) and issubclass(value, self._base) and not inspect.isabstract(value)
            )
            if is_member and value.__module__ == module_name and "name" in vars(value):
                yield value

    def __getitem__(self, name: str) -> type[T]:
        try:
            return self._members[name]
        except KeyError:
            close = get_close_matches(name, self._members, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            raise InputError(
                f"no {self.kind} is called '{name}'{hint} Valid: {', '.join(self._members)}"
            ) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)

    def __contains__(self, name: object) -> bool:
        return name in self._members
