"""How far the positions of a channel are off, as they were read."""

from estimation.channel import ChannelData
from estimation.data.derivatives import grid_step, position_error, rounding_variance
from estimation.signals.cache_by_array import cache_by_channel_arrays
from robot_io.types import FloatArray


@cache_by_channel_arrays("time_s", "position", "run", "position_step")
def reading_error(data: ChannelData) -> FloatArray:
    """What each position differs by from the smooth motion, shape (n,); see `position_error`."""
    step = data.position_step or grid_step(data.position)
    rounding = rounding_variance(data.time_s, data.position, data.run, step)
    return position_error(data.time_s, data.position, data.run, rounding)[0]
