"""What follows when the load does not move as the encoder does."""

from dataclasses import replace

from estimation.channel import ChannelData
from robot_io.types import FloatArray

BY_POSITION, BY_ACCELERATION = "_by_position", "_by_acceleration"  # derivatives of a signal, beside it


def shifted_motion(
    data: ChannelData, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> ChannelData:
    """The channel with these changes of its motion, each of shape (n,).

    Signals of the context that depend on the motion (a rigid body's efforts) are moved along to first order
    where their derivatives by the channel's own position and acceleration are in the context.
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
