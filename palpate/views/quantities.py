"""What a channel's quantities are called, and in which units they are shown."""

from dataclasses import dataclass

from estimation.channel import ChannelData, ChannelKind


@dataclass(frozen=True)
class Quantities:
    """How to show a channel.

    Attributes:
        effort: what was measured, with its unit.
        effort_unit: the unit alone.
        position: with the unit that it is shown in.
        velocity: likewise.
        scale: from SI to the unit in which position and velocity are shown.
    """

    effort: str
    effort_unit: str
    position: str
    velocity: str
    scale: float


def quantities_of(data: ChannelData) -> Quantities:
    """A contact and a sliding joint are shown in millimetres, a turning joint in radians."""
    unit = data.kind.effort_unit
    match data.kind:
        case ChannelKind.CONTACT:
            return Quantities(f"contact force [{unit}]", unit, "depth [mm]", "velocity inwards [mm/s]", 1e3)
        case ChannelKind.PRISMATIC:
            return Quantities(f"force [{unit}]", unit, "position [mm]", "velocity [mm/s]", 1e3)
    return Quantities(f"torque [{unit}]", unit, "position [rad]", "velocity [rad/s]", 1.0)
