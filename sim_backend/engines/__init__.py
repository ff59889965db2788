"""Physics engines, one file each; see `sim_backend.engines.engine`. Neither is imported before it is used."""

from importlib import import_module
from importlib.util import find_spec
from typing import Literal

from robot_io.errors import InputError
from sim_backend.engines.engine import Engine

EngineName = Literal["pybullet", "mujoco"]

# name: (package that must be installed, module of ours, class)
_ENGINES: dict[EngineName, tuple[str, str, str]] = {
    "pybullet": ("pybullet", "pybullet_engine", "PyBulletEngine"),
    "mujoco": ("mujoco", "mujoco_engine", "MujocoEngine"),
}


def installed_engines() -> list[EngineName]:
    """Those that can be used here, the default first: PyBullet where its wheel exists, elsewhere MuJoCo."""
    return [name for name, (package, *_) in _ENGINES.items() if find_spec(package)]


def default_engine() -> EngineName:
    """What simulates where nothing else is asked for."""
    return next(iter(installed_engines()), "mujoco")


def engine_class(name: EngineName) -> type[Engine]:
    """The engine of this name. InputError: it is not installed."""
    package, module, kind = _ENGINES[name]
    if not find_spec(package):
        raise InputError(
            f"physics engine '{name}': package {package} is not installed. Install it, or choose "
            f"engine {default_engine()}"
        )
    found: type[Engine] = getattr(import_module(f"sim_backend.engines.{module}"), kind)
    return found


__all__ = ["Engine", "EngineName", "default_engine", "engine_class", "installed_engines"]
