"""The linear problem that every estimator solves."""

from dataclasses import dataclass, replace

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Regression:
    """effort = columns @ gains + noise."""

    columns: FloatArray  # shape (n, p)
    effort: FloatArray  # shape (n,)
    names: tuple[str, ...]  # the p gains' names
    units: tuple[str, ...]  # the p gains' units
    # Number of the run of each sample, shape (n,); the noise of samples of one run, in order of time, may be
    # correlated, that of different runs is not. None for one run.
    run: IntArray | None = None

    def __post_init__(self) -> None:
        """Check shapes. InputError: they do not belong together, or there are fewer samples than gains."""
        samples, gains = self.columns.shape
        if self.effort.shape != (samples,) or len(self.names) != gains or len(self.units) != gains:
            raise InputError(
                f"regression: columns {self.columns.shape}, effort {self.effort.shape}, names {self.names}"
            )
        if self.run is not None and self.run.shape != (samples,):
            raise InputError(f"regression: run has shape {self.run.shape}, expected ({samples},)")
        if samples <= gains:
            raise InputError(f"regression: {samples} samples cannot determine {gains} parameters")

    def select(self, rows: BoolArray | IntArray) -> "Regression":
        """The problem with only these samples (a mask or indices)."""
        run = None if self.run is None else self.run[rows]
        return replace(self, columns=self.columns[rows], effort=self.effort[rows], run=run)
