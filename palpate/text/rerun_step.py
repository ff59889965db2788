"""How to see a model grow."""

from pathlib import Path

from palpate.doctor.viewer import has_display
from palpate.words import typed


def rerun_step(recording: Path) -> tuple[str, str]:
    """The command that opens a recording of revisions, with what it does and what it needs."""
    where = "" if has_display() else " (needs a display)"
    return f"rerun {typed(recording)}", f"see the model grow, revision by revision{where}"
