"""Change the motion of a channel, with all signals that depend on it."""

from dataclasses import replace

from estimation.channel import ChannelData
from robot_io.types import FloatArray

BY_POSITION, BY_ACCELERATION = "_by_position", "_by_acceleration"  # suffixes of a signal's derivatives


def shifted_motion(
    data: ChannelData, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> ChannelData:
    """Add changes to the motion of a channel.

    Signals of the context that depend on the motion, such as a rigid body's torque, change to first order
    where the context has their derivatives by the channel's own position and acceleration.

    Args:
        data: the channel.
        position: change of position, shape (n,), in the unit of position.
        velocity: change of velocity, shape (n,).
        acceleration: change of acceleration, shape (n,).
    """
    context = dict(data.context)
    for name, values in data.context.items():
        if name + BY_POSITION in data.context and name + BY_ACCELERATION in data.context:
            columns = [-1] + [1] * (values.ndim - 1)
            context[name] = (
                values
                + data.context[name + BY_POSITION] * position.reshape(columns)
                + data.context[name + BY_ACCELERATION] * acceleration.reshape(columns)
            )
    return replace(
        data,
        position=data.position + position,
        velocity=data.velocity + velocity,
        acceleration=data.acceleration + acceleration,
        context=context,
    )
