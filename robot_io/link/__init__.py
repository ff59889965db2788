"""Messages between two machines: what they hold, how they are framed, and the line that carries them."""

from robot_io.link.frame import Frame, FrameError, decode, encode
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

__all__ = [
    "ContactModel",
    "Frame",
    "FrameError",
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
    "short_number",
    "target_number",
]
