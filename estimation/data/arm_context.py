"""What a joint needs to know of the other joints."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind

OF_THE_ARM = ("joint_position", "joint_velocity", "joint_acceleration")
# Derived signals of a joint: a column of that name, perhaps a mass, would pass for what a model needs.
DERIVED = ("load", "rigid_body_torque", "rigid_body_regressor", "payload_effort_per_kg")


def with_arm(channels: Sequence[ChannelData]) -> tuple[ChannelData, ...]:
    """The channels, each joint's with the motion of all joints in its context, (n, joints) each."""
    joints = [channel for channel in channels if channel.kind is not ChannelKind.CONTACT]
    if not joints:
        return tuple(channels)
    motions = ((joint.position, joint.velocity, joint.acceleration) for joint in joints)
    arm = dict(zip(OF_THE_ARM, map(np.column_stack, zip(*motions, strict=True)), strict=True))
    return tuple(
        channel
        if channel.kind is ChannelKind.CONTACT
        else replace(channel, context={**channel.context, **arm})
        for channel in channels
    )
