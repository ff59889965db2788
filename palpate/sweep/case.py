"""One case of a sweep, and the address at which its result is kept.

The address is the SHA-256 of everything that the result depends on: what is worked out, the parameters, the
seed, and the code. A result that is there need never be worked out again; after a change of the code nothing
old is taken for new.
"""

import importlib
import importlib.util
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from robot_io.errors import InputError

Row = dict[str, Any]
Work = Callable[[Mapping[str, Any], int], list[Row]]
"""Parameters and seed in, rows of scalars out; equal arguments give equal rows."""

_PHYSICS = ("robot_io", "control", "estimation", "sim_backend")
_LIBRARIES = ("numpy", "scipy", "pin", "pybullet", "mujoco-core")
_ENDINGS = {".py", ".urdf", ".yaml"}


@dataclass(frozen=True)
class Case:
    """One case."""

    work: str  # "package.module:function", a `Work`
    parameters: Mapping[str, Any]  # what JSON can hold; its text is part of the address
    seed: int = 0  # of all that is random in it

    @property
    def address(self) -> str:
        """64 hexadecimal digits."""
        parts = [self.work, self.parameters, self.seed, code_version(self.work.partition(":")[0])]
        return sha256(json.dumps(parts, sort_keys=True, allow_nan=False).encode()).hexdigest()

    def run(self) -> list[Row]:
        """Work it out. Exception: whatever the work raises."""
        module, _, function = self.work.partition(":")
        work: Work = getattr(importlib.import_module(module), function)
        return work(self.parameters, self.seed)


@cache
def code_version(module: str) -> str:
    """SHA-256 of the code that decides about results: palpate's physics, the work's folder, the libraries.

    Raises:
        InputError: there is no such module.
    """
    digest = sha256("".join(f"{name} {_version_of(name)}\n" for name in _LIBRARIES).encode())
    for folder in (*map(_folder_of, _PHYSICS), _folder_of(module)):
        for path in sorted(folder.rglob("*")):
            if path.suffix in _ENDINGS and path.is_file():
                digest.update(f"{folder.name}/{path.relative_to(folder).as_posix()}\0".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _version_of(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"


def _folder_of(module: str) -> Path:
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        raise InputError(f"work '{module}': Python finds no such module")
    return Path(found.origin).parent
