"""Messages between two machines: content, frames, and the line that carries them."""

from palpate.robot_io.link.frame import Frame, FrameError, Heard, decode, encode, load_seal
from palpate.robot_io.link.line import Impairment, Line, LineSettings
from palpate.robot_io.link.messages import (
    ContactModel,
    EstimatedParameter,
    Intent,
    Message,
    ObjectEstimate,
    Report,
    Target,
    TargetState,
    short_number,
    target_number,
)

__all__ = [
    "ContactModel",
    "EstimatedParameter",
    "Frame",
    "FrameError",
    "Heard",
    "Impairment",
    "Intent",
    "Line",
    "LineSettings",
    "Message",
    "ObjectEstimate",
    "Report",
    "Target",
    "TargetState",
    "decode",
    "encode",
    "load_seal",
    "short_number",
    "target_number",
]
