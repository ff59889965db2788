"""Messages between two machines: what they hold, how they are framed, and the line that carries them."""

from robot_io.link.frame import Frame, FrameError, Heard, decode, encode
from robot_io.link.impairment import Impairment
from robot_io.link.line import Line, LineSettings
from robot_io.link.messages import (
    ContactModel,
    Intent,
    Message,
    ObjectEstimate,
    Parameter,
    Report,
    Target,
    TargetState,
    short_number,
    target_number,
)
from robot_io.link.seal import load_seal

__all__ = [
    "ContactModel",
    "Frame",
    "FrameError",
    "Heard",
    "Impairment",
    "Intent",
    "Line",
    "LineSettings",
    "Message",
    "ObjectEstimate",
    "Parameter",
    "Report",
    "Target",
    "TargetState",
    "decode",
    "encode",
    "load_seal",
    "short_number",
    "target_number",
]
