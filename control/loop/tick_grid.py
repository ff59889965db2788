"""When the ticks are due: a grid of absolute times, so that late ticks neither drift nor bunch."""

import math


class TickGrid:
    """The instants `start_s + k * period_s`, walked in order.

    Each instant is computed from the start, never from the previous tick, so that a million ticks end where a
    million periods end. A tick that is still running when the next one is due has overrun; the grid then goes
    on at the next instant that is still ahead; those in between are skipped, never made up for in a burst.

    Args:
        start_s: time of the first tick [s].
        period_s: time between ticks [s].
    """

    def __init__(self, start_s: float, period_s: float) -> None:
        self.start_s = start_s
        self.period_s = period_s
        self.index = 0
        self.overruns = 0  # ticks that ended after the next one was due
        self.skipped = 0  # instants without a tick

    @property
    def due_s(self) -> float:
        """When the current tick is due [s]."""
        return self.start_s + self.index * self.period_s

    def advance(self, now_s: float) -> int:
        """Go on to the next tick.

        Args:
            now_s: when the current tick ended, on the same clock [s].

        Returns:
            How many periods the next tick is after the current one: 1, or more after an overrun.
        """
        previous = self.index
        self.index = previous + 1
        if now_s > self.due_s:
            # Rounding may put the ceiling one instant early; the instant must not have passed.
            self.index = max(self.index, math.ceil((now_s - self.start_s) / self.period_s))
            self.index += now_s > self.due_s
            self.overruns += 1
            self.skipped += self.index - previous - 1
        return self.index - previous
