"""Rerun recordings of a session."""

from palpate.views.recording.write import write_recording

__all__ = ["write_recording"]
