"""Results of a study: immutable objects that notebooks show as tables."""

from dataclasses import dataclass

from palpate.estimation.diagnosis import ChannelDiagnosis, Diagnosis
from palpate.estimation.estimate import DisplayTable, ParameterEstimate, TableDisplay, with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.study.channels import StudyChannel
from palpate.estimation.study.comparison import Comparison
from palpate.estimation.study.revisions import Revision


@dataclass(frozen=True, eq=False)
class ModelStage:
    """One stage of a model."""

    fitted: FitResult  # the fitted model of this stage
    added: str = ""  # effect added at this stage; empty for the base model
    number: int | None = None  # number of the revision in which it is saved; None if it is not saved

    @property
    def rmse(self) -> float:
        """Held-out error."""
        return self.fitted.rmse

    @property
    def parameters(self) -> dict[str, ParameterEstimate]:
        """Parameters by "effect.parameter"."""
        return dict(self.fitted.parameters)


@dataclass(frozen=True, eq=False, repr=False)
class ChannelResult(TableDisplay):
    """One channel with all its results."""

    channel: StudyChannel  # the channel and its base model
    diagnosis: ChannelDiagnosis | None = None  # diagnosis of the base model; None if it was not diagnosed
    # Comparison of the base model with the measurement; None if the channel cannot be fitted.
    comparison: Comparison | None = None
    # The base model, and one stage for each added effect; empty if the channel cannot be fitted.
    stages: tuple[ModelStage, ...] = ()
    # Comparison of the last stage with the measurement; None without effects.
    extended_comparison: Comparison | None = None
    reason: str = ""  # why the comparison or added effects are missing; otherwise empty

    @property
    def noise(self) -> MeasurementNoise | None:
        """Noise of the channel, to which all errors refer; None if the channel cannot be fitted."""
        return None if self.comparison is None else self.comparison.noise

    @property
    def added(self) -> list[str]:
        """Effects that were added to the base model, in order."""
        return [stage.added for stage in self.stages[1:]]

    @property
    def left_out(self) -> bool:
        """Whether some added effects are not shown; `reason` explains why."""
        return bool(self.stages and self.reason)

    @property
    def shown(self) -> Comparison | None:
        """Comparison of the largest model with the measurement."""
        return self.extended_comparison or self.comparison

    def _table(self) -> DisplayTable:
        unit = self.channel.effort_unit
        noise = self.noise.value if self.noise else float("nan")
        rows = [
            (
                "" if stage.number is None else stage.number,
                f"+ {stage.added}" if stage.added else stage.fitted.model.name,
                with_unit(stage.rmse, unit, 4),
                f"{stage.rmse / noise:.2f}",
            )
            for stage in self.stages
        ]
        level = f"noise {self.noise.describe(unit)}. " if self.noise else ""
        caption = f"{self.channel.name}: {level}{self.reason}"
        return DisplayTable(caption, ("revision", "model", "held-out error", "x noise"), rows)


@dataclass(frozen=True, eq=False, repr=False)
class RevisionChange(TableDisplay):
    """Result of adding or removing effects."""

    result: ChannelResult  # all stages of the channel, starting with the base model
    revisions: tuple[Revision, ...]  # the new revisions
    parent: Revision | None  # the revision that was continued; None if the change started from the base model

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
                with_unit(entry.rmse, entry.effort_unit, 4),
                entry.created_utc,
            )
            for entry in self
        ]
        columns = ("revision", "from", "channel", "model", "held-out error", "made")
        return DisplayTable("Revisions", columns, rows)
