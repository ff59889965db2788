"""Results of a study: immutable objects, which a notebook shows as tables."""

from dataclasses import dataclass

from palpate.estimation.diagnosis import ChannelDiagnosis, Diagnosis
from palpate.estimation.estimate import DisplayTable, ParameterEstimate, TableDisplay
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.study.channels import StudyChannel
from palpate.estimation.study.comparison import Comparison
from palpate.estimation.study.revisions import Revision


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of a model."""

    fitted: FitResult  # the model at this stage
    added: str = ""  # effect that this stage added; empty for the base model
    number: int | None = None  # of the revision that it is kept as; None where it is not kept

    @property
    def rmse(self) -> float:
        """Error in held-out runs."""
        return self.fitted.rmse

    @property
    def parameters(self) -> dict[str, ParameterEstimate]:
        """Parameters by "effect.parameter"."""
        return dict(self.fitted.parameters)


@dataclass(frozen=True, eq=False, repr=False)
class ChannelResult(TableDisplay):
    """One channel with all its results."""

    channel: StudyChannel  # the channel and its base model
    diagnosis: ChannelDiagnosis | None = None  # what is missing; None where nobody asked
    # The base model beside the measurement; None where the data cannot be judged.
    comparison: Comparison | None = None
    # The base model, and one stage for each effect added; empty where the data cannot be judged.
    stages: tuple[Stage, ...] = ()
    grown: Comparison | None = None  # the last stage beside the measurement; None where nothing was added
    # Of the channel, by which all its stages are measured; None as for the comparison.
    noise: MeasurementNoise | None = None
    reason: str = ""  # why there is no comparison, or why what was added is left out; empty else

    @property
    def added(self) -> list[str]:
        """Effects that were added to the base model, in order."""
        return [stage.added for stage in self.stages[1:]]

    @property
    def left_out(self) -> bool:
        """Whether more effects were added than are shown; `reason` explains why."""
        return bool(self.stages and self.reason)

    @property
    def shown(self) -> Comparison | None:
        """The comparison of the largest model with the measurement."""
        return self.grown or self.comparison

    def _table(self) -> DisplayTable:
        unit = self.channel.effort_unit
        noise = self.noise.value if self.noise else float("nan")
        rows = [
            (
                "" if stage.number is None else stage.number,
                f"+ {stage.added}" if stage.added else stage.fitted.model.name,
                f"{stage.rmse:.4g} {unit}",
                f"{stage.rmse / noise:.2f}",
            )
            for stage in self.stages
        ]
        level = f"noise {self.noise.describe(unit)}. " if self.noise else ""
        caption = f"{self.channel.name}: {level}{self.reason}"
        return DisplayTable(caption, ("revision", "model", "held-out error", "x noise"), rows)


@dataclass(frozen=True, eq=False, repr=False)
class Change(TableDisplay):
    """Result of adding or removing effects."""

    result: ChannelResult  # all stages of the channel, from the base model on
    revisions: tuple[Revision, ...]  # those that are new
    parent: Revision | None  # the revision that was continued; None for a new beginning

    def _table(self) -> DisplayTable:
        return self.result._table()


class StudyDiagnosis(TableDisplay, Diagnosis):
    """A diagnosis whose errors and parameters come from the study's own fits."""

    def _table(self) -> DisplayTable:
        rows = [
            (entry.channel, entry.verdict, ", ".join(a.effect for a in entry.accepted), entry.reason)
            for entry in self.channels
        ]
        columns = ("channel", "verdict", "effects", "why")
        return DisplayTable(f"What is missing in {self.model}", columns, rows)


class RevisionTable(TableDisplay, tuple[Revision, ...]):
    """Revisions, oldest first."""

    __slots__ = ()

    def _table(self) -> DisplayTable:
        rows = [
            (
                entry.number,
                "" if entry.parent is None else entry.parent,
                entry.channel,
                " + ".join([entry.model, *entry.effects]),
                f"{entry.rmse:.4g} {entry.effort_unit}",
                entry.created_utc,
            )
            for entry in self
        ]
        columns = ("revision", "from", "channel", "model", "held-out error", "made")
        return DisplayTable("Revisions", columns, rows)
