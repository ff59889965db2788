"""Physics engines, one file each; see `palpate.sim_backend.engines.engine`. Each is imported on first use."""

from importlib import import_module
from importlib.util import find_spec
from typing import Literal

from palpate.robot_io.errors import InputError
from palpate.robot_io.extras import missing_package
from palpate.sim_backend.engines.engine import Engine

EngineName = Literal["pybullet", "mujoco"]

# name: (package that must be installed, module of ours, class)
_ENGINES: dict[EngineName, tuple[str, str, str]] = {
    "pybullet": ("pybullet", "pybullet_engine", "PyBulletEngine"),
    "mujoco": ("mujoco", "mujoco_engine", "MujocoEngine"),
}


def installed_engines() -> list[EngineName]:
    """List the installed engines, the default first: PyBullet where its wheel exists, elsewhere MuJoCo."""
    return [name for name, (package, *_) in _ENGINES.items() if find_spec(package)]


def default_engine() -> EngineName:
    """Return the name of the default engine."""
    return next(iter(installed_engines()), "mujoco")


def engine_class(name: EngineName) -> type[Engine]:
    """Import an engine.

    Args:
        name: name of the engine.

    Raises:
        InputError: it is not installed.
    """
    package, module, kind = _ENGINES[name]
    if not find_spec(package):
        others = [f"choose {choice}" for choice in installed_engines()]
        raise InputError("; or ".join((f"physics engine '{name}': {missing_package(package)}", *others)))
    engine: type[Engine] = getattr(import_module(f"palpate.sim_backend.engines.{module}"), kind)
    return engine


__all__ = ["Engine", "EngineName", "default_engine", "engine_class", "installed_engines"]
