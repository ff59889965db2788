"""Packages with drivers of the user's own."""

import importlib.util

from robot_io.errors import InputError


def importable(packages: list[str]) -> tuple[str, ...]:
    """The packages, if Python finds them.

    Raises:
        InputError: it does not find one of them.
    """
    for package in packages:
        try:
            found = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            found = None
        if found is None:
            raise InputError(f"--drivers {package}: Python finds no such package (see PYTHONPATH)")
    return tuple(packages)
