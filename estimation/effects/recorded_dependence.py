"""A gain that depends on something that was recorded beside."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from robot_io.types import FloatArray


class RecordedDependence(SensorEffect):
    """reading = (1 + c u) effort, u the recorded column less its mean, in standard deviations.

    `suited_to` makes one such parameter for each column that was recorded, by its name.

    Args:
        columns: name, mean and standard deviation of each.
    """

    name = "recorded_dependence"
    kind = Kind.RECORDED_CONTEXT
    physics = "Stiffness, friction or the sensor change with temperature, place or what else was recorded."
    equation = "reading = (1 + sum_j c_j (r_j - mean r_j)/sd r_j) effort"
    source = "D. C. Montgomery, Design and Analysis of Experiments (2012), ch. 15: covariates"
    signature = "the whole effort is larger by a share where the recorded column is larger"
    signals = ("recorded",)
    channels = frozenset(ChannelKind)
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("change", "1", -3.0, 3.0, (-0.3, 0.3)),)
    linear = True
    confused_with = {
        "run_gain": "vary the recorded quantity within a run",
        "drift": "vary the recorded quantity up and down, not steadily with time",
        "torque_gain": "vary the recorded quantity: a wrong constant is always the same",
    }

    def __init__(self, columns: tuple[tuple[str, float, float], ...] = ()) -> None:
        self._columns = columns
        if columns:
            change = RecordedDependence.inner[0]
            names = [f"change_{name}" for name, _, _ in columns]
            self.inner = tuple(  # type: ignore[misc]  # how many there are depends on the data
                Parameter(name, change.unit, change.lower, change.upper, change.typical) for name in names
            )

    def suited_to(self, data: ChannelData) -> "RecordedDependence":
        recorded = {name: data.context[name] for name in sorted(data.recorded)}
        found = ((name, float(np.mean(r)), float(np.std(r))) for name, r in recorded.items())
        return RecordedDependence(tuple(column for column in found if column[2] > 0.0))

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: something was recorded, and it varies."""
        varies = any(float(np.ptp(data.context[name])) > 0.0 for name in data.recorded)
        return super().applies_to(data) and varies

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        gain = np.ones(len(data))
        for name, mean, deviation in self._columns:
            gain += inner[f"change_{name}"] * (data.context[name] - mean) / deviation
        return gain.reshape(-1, *([1] * (effort.ndim - 1))) * effort

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: one column after the other, to either side."""
        names = [parameter.name for parameter in self.inner]
        return tuple(
            {name: change if name == one else 0.0 for name in names}
            for one in names
            for change in (-0.2, -0.03, 0.03, 0.2)
        )
