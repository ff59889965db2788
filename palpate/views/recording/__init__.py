"""Rerun recordings of a session."""

from palpate.views.recording.channels import write_channels
from palpate.views.recording.write import write_recording

__all__ = ["write_channels", "write_recording"]
