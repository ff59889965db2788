"""What a sensor reads with nothing to read, taken off its readings."""

from dataclasses import dataclass

import numpy as np

from palpate.robot_io.types import FloatArray, IntArray


@dataclass(frozen=True)
class Tare:
    """The effort in free air, run by run; r runs.

    A run's tare is a mean of noisy samples. Its error is the same in all samples of the run, so that more of
    them do not average it out.
    """

    run: IntArray  # their numbers, ascending, shape (r,)
    effort: FloatArray  # mean in free air, shape (r,)
    std_err: FloatArray  # its standard error, shape (r,)

    def of(self, run: IntArray) -> FloatArray:
        """What to take off each sample of these runs, shape (n,).

        Args:
            run: number of each sample's run, shape (n,).
        """
        taken: FloatArray = self.effort[np.searchsorted(self.run, run)]
        return taken

    def errors(self, run: IntArray) -> FloatArray:
        """One standard error of each tare in the samples that share it, shape (n, r).

        Args:
            run: number of each sample's run, shape (n,).
        """
        return np.where(run[:, None] == self.run, self.std_err, 0.0)
