"""Packages that only a part of palpate needs: imported on first use, and installed with an extra."""

from importlib import import_module
from types import ModuleType
from typing import Any

EXTRAS = {  # what Python imports: the package that has it, and the extra that installs it
    "can": ("python-can", "hardware"),
    "distributed": ("distributed", "sweep"),
    "foxglove": ("foxglove-sdk", "foxglove"),
    "matplotlib": ("matplotlib", "sweep"),
    "mujoco": ("mujoco-core", "sim"),
    "nicegui": ("nicegui", "workbench"),
    "pinocchio": ("pin", "arm"),
    "pybullet": ("pybullet", "sim"),
    "rerun": ("rerun-sdk", "view"),
    "rerun_cli": ("rerun-sdk", "view"),
    "serial": ("pyserial", "hardware"),
    "uvicorn": ("nicegui", "workbench"),
    "zenoh": ("eclipse-zenoh", "teleop"),
}


def missing_package(module: str | None) -> str | None:
    """Return one line with the command that installs a module; None if no extra contains it.

    Args:
        module: name of the missing module, as Python imports it.
    """
    package, extra = EXTRAS.get((module or "").partition(".")[0], ("", ""))
    return f"the package {package} is not installed: pip install 'palpate[{extra}]'" if extra else None


class LazyModule(ModuleType):
    """A module that is imported when something in it is used for the first time.

    Args:
        name: name of the module, as Python imports it.

    Raises:
        ModuleNotFoundError: at first use; the message states the command that installs the module.
    """

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """Import the module, and keep what was asked for."""
        try:
            value = getattr(import_module(self.__name__), name)
        except ModuleNotFoundError as error:
            text = missing_package(error.name) or str(error)
            raise ModuleNotFoundError(text, name=error.name) from None
        setattr(self, name, value)
        return value
