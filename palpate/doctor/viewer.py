"""The Rerun viewer."""

import os
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from palpate.common.formatting import typed
from robot_io.examination import Finding, Level, graded

VULKAN_DRIVERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")


def rerun() -> Iterator[Finding]:
    """The viewer's program is there, and something to show it on."""
    shows = (
        "with a display" if has_display() else "no display: recordings and screenshots are written to files"
    )
    blind = not has_display() and not has_vulkan_driver()
    if blind:
        shows = "neither display nor Vulkan driver: recordings yes, screenshots no"
    value = f"{metadata.version('rerun-sdk')}, {shows}"
    yield graded("rerun", value, (Level.WARN, blind, "apt install mesa-vulkan-drivers"))


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def has_vulkan_driver() -> bool:
    """Whether Vulkan can draw, if only in software."""
    return any(Path(folder).is_dir() and any(Path(folder).glob("*.json")) for folder in VULKAN_DRIVERS)


def rerun_step(recording: Path) -> tuple[str, str]:
    """The command that opens a recording of revisions, with what it does and what it needs."""
    where = "" if has_display() else " (needs a display)"
    return f"rerun {typed(recording)}", f"see the model grow, revision by revision{where}"
