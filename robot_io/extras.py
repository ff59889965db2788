"""Packages that only a part of palpate needs: imported on first use, and installed with an extra."""

import json
import shlex
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urlsplit

EXTRAS = {  # what Python imports: the package that has it, and the extra that installs it
    "can": ("python-can", "hardware"),
    "distributed": ("distributed", "sweep"),
    "foxglove": ("foxglove-sdk", "foxglove"),
    "h5py": ("h5py", "files"),
    "matplotlib": ("matplotlib", "sweep"),
    "mujoco": ("mujoco-core", "sim"),
    "nicegui": ("nicegui", "workbench"),
    "nptdms": ("npTDMS", "files"),
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
    return f"the package {package} is not installed: {install_command(extra)}" if extra else None


def install_command(extra: str = "") -> str:
    """Return the command that completes this installation, from where palpate itself was installed.

    Args:
        extra: name of the extra to add, such as "view"; empty for the packages that palpate always needs.
    """
    from importlib.metadata import distributions  # noqa: PLC0415, it takes long to import and is rarely needed

    records = (found.read_text("direct_url.json") for found in distributions(name="palpate"))
    what = f"[{extra}]" if extra else ""
    origin = json.loads(next(filter(None, records), "{}"))  # empty if palpate came from an index of packages
    if not (url := origin.get("url", "")):
        return f"pip install {shlex.quote(f'palpate{what}')}"
    if not url.startswith("file:"):
        control = origin.get("vcs_info", {})
        system = control["vcs"] + "+" if control else ""
        revision = f"@{control['requested_revision']}" if control.get("requested_revision") else ""
        folder = f"#subdirectory={origin['subdirectory']}" if origin.get("subdirectory") else ""
        return f"pip install {shlex.quote(f'palpate{what} @ {system}{url}{revision}{folder}')}"
    path = Path(unquote(urlsplit(url).path))
    place = "." if path == Path.cwd() else str(path)
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f"pip install {editable}{shlex.quote(f'{place}{what}')}"


class LazyModule(ModuleType):
    """A module that is imported when something in it is used for the first time.

    Args:
        name: name of the module, as Python imports it.

    Raises:
        ModuleNotFoundError: at first use; the message states the command that installs the module.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        # Python calls a module's own `__getattr__` only for missing attributes (PEP 562). If it were a method
        # of the class, every access would be slower.
        self.__dict__["__getattr__"] = self._load

    def _load(self, name: str) -> Any:  # noqa: ANN401
        """Import the module, and keep what was asked for."""
        try:
            value = getattr(import_module(self.__name__), name)
        except ModuleNotFoundError as error:
            text = missing_package(error.name) or str(error)
            raise ModuleNotFoundError(text, name=error.name) from None
        setattr(self, name, value)
        return value
