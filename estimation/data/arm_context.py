"""What a joint needs to know of the other joints."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind


def with_arm(channels: Sequence[ChannelData]) -> tuple[ChannelData, ...]:
    """The channels, each joint's with the motion of all joints in its context, (n, joints) each."""
    joints = [channel for channel in channels if channel.kind is not ChannelKind.CONTACT]
    if not joints:
        return tuple(channels)
    arm = {
        "joint_position": np.column_stack([joint.position for joint in joints]),
        "joint_velocity": np.column_stack([joint.velocity for joint in joints]),
        "joint_acceleration": np.column_stack([joint.acceleration for joint in joints]),
    }
    return tuple(
        channel
        if channel.kind is ChannelKind.CONTACT
        else replace(channel, context={**channel.context, **arm})
        for channel in channels
    )
