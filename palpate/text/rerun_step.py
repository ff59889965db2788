"""How to see a model grow."""

from pathlib import Path

from palpate.doctor.viewer import has_display
from palpate.words import typed


def rerun_step(recording: Path) -> tuple[str, str]:
    """The command that opens a recording of revisions, with what it does and where that can be done."""
    where = "" if has_display() else " (where there is a display, with rerun-sdk of the same version)"
    return f"rerun {typed(recording)}", f"see the model grow, revision by revision{where}"
