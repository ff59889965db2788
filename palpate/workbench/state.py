"""State of the workbench, independent of any page: a study, the selected model, and undo."""

from collections import deque
from collections.abc import Mapping, MutableSequence, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from palpate.common.console import as_shell_word
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.candidates import applicable_effects
from palpate.estimation.effect import Effect, Parameter
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_noise import MeasurementNoise
from palpate.estimation.study import Revision, StudyChannel
from palpate.estimation.study.source import DataSource, joined, open_source
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray
from palpate.study import Study

Value = TypeVar("Value")
Bounds = tuple[float, float]
_Runs = tuple[tuple[int, ...], tuple[int, ...]]  # runs left out, runs held out
_Step = tuple["ModelSelection", _Runs]  # one step of undo and redo
_MOST_STEPS = 100  # largest number of undo steps


@dataclass(frozen=True)
class ModelSelection:
    """The selected model: one step of undo and redo."""

    channel: str  # its name
    effects: tuple[str, ...] = ()  # effects added to the base model, in order
    # Held parameters, by "effect.parameter".
    held: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, Bounds] = field(default_factory=dict)  # bounds of further parameters
    # Values of moved sliders: drawn, not fitted; a new fit resets the sliders.
    slider_values: Mapping[str, float] = field(default_factory=dict)

    @property
    def fitted(self) -> "ModelSelection":
        """The same selection with all sliders at the fitted values."""
        return replace(self, slider_values={})

    def with_effects(self, effects: Sequence[str]) -> "ModelSelection":
        """Return the selection with other effects, and without settings of removed parameters.

        Args:
            effects: their names, in order.
        """
        removed = set(self.effects) - set(effects)
        held = {name: value for name, value in self.held.items() if name.partition(".")[0] not in removed}
        bounds = {name: pair for name, pair in self.bounds.items() if name.partition(".")[0] not in removed}
        return ModelSelection(self.channel, tuple(effects), held, bounds)


@dataclass(frozen=True, eq=False)
class DisplayedFit:
    """The selected model and the base model."""

    choice: ModelSelection  # the selection
    base: FitResult  # the base model
    fitted: FitResult  # fit of the selection; intervals are computed on first use
    # Label and held-out error of the base model and of each effect added.
    steps: tuple[tuple[str, float], ...]
    noise: MeasurementNoise  # noise of the channel [effort]
    is_rough: bool = False  # whether it is a preview of the fit
    is_incomplete: bool = False  # whether the diagnosis states that the selected model lacks an effect

    @property
    def values(self) -> dict[str, float]:
        """Parameters as drawn: fitted values, and values of moved sliders."""
        return {**self.fitted.values, **self.choice.slider_values}

    def compute_intervals(self) -> None:
        """Compute what is slow and cached: intervals, impossible gains, and the flexible regression."""
        _ = self.fitted.parameters, self.fitted.unphysical, self.fitted.smooth_law_error


class WorkbenchState:
    """One study on the page, with undo and redo.

    Args:
        study: study to show.
        source: the file with its options as typed in a command; empty for data without a file.
    """

    def __init__(self, study: Study, source: str = "") -> None:
        self.study, self.source = study, source
        self.whole: WorkbenchState | None = None  # study with all runs, as the page was opened
        self.out: tuple[int, ...] = ()
        self._past: deque[_Step] = deque(maxlen=_MOST_STEPS)
        self._future: list[_Step] = []
        self._moved_slider = ""  # parameter whose slider is being pulled
        first = next((channel for channel in study.channels if not study.refusal(channel)), study.channels[0])
        self.choice = self._start_of(first.name)

    @property
    def channel(self) -> StudyChannel:
        """The selected channel with its base model."""
        return self.study.channel(self.choice.channel)

    @property
    def diagnosis(self) -> ChannelDiagnosis | None:
        """Diagnosis of this channel; None if there is none yet."""
        return self.study.known_diagnosis(self.channel)

    def effects(self) -> tuple[Effect, ...]:
        """Effects that can be added to this channel's base model."""
        fitted = self.study.fit(self.channel)
        return applicable_effects(fitted.data, fitted.model, self.study.effects)

    def show(self, choice: ModelSelection | None = None) -> DisplayedFit:
        """Fit a selection, by default the current one, in the same way as the commands.

        Args:
            choice: channel, effects and held parameters; None for the present choice.

        Raises:
            InputError: the selection cannot be fitted.
        """
        chosen = choice or self.choice
        channel, names = self.study.channel(chosen.channel), chosen.effects
        stages = [self.study.fit(channel, names[:count]) for count in range(len(names) + 1)]
        fitted = self.study.fit_held(channel, names, chosen.held, chosen.bounds)
        return self._shown(chosen, stages if fitted is stages[-1] else [*stages, fitted])

    def _shown(
        self, choice: ModelSelection, stages: Sequence[FitResult], *, is_rough: bool = False
    ) -> DisplayedFit:
        """Return the last of nested fits, with the errors of all."""
        base = stages[0]
        labels = [base.model.name, *(f"+ {name}" for name in choice.effects), "held and bounded"]
        steps = tuple((label, stage.rmse) for label, stage in zip(labels, stages, strict=False))
        noise = self.study.noise(choice.channel).below(min(stage.rmse for stage in stages))
        diagnosis = None
        with suppress(InputError):  # the card of the diagnosis reports a damaged file
            diagnosis = self.study.known_diagnosis(self.study.channel(choice.channel))
        lacks = False
        if diagnosis is not None and diagnosis.final is not None:
            noise, names = noise.below(diagnosis.final.rmse), {entry.effect for entry in diagnosis.accepted}
            is_missing = diagnosis.verdict in {Verdict.MISSING, Verdict.UNEXPLAINED}
            is_remaining = set(choice.effects) == names and diagnosis.complete is False
            lacks = is_missing and (not choice.effects or is_remaining)
        return DisplayedFit(choice, base, stages[-1], steps, noise, is_rough, lacks)

    def preview(self, choice: ModelSelection) -> DisplayedFit | None:
        """Predict the result of `show` roughly; None if it is known, or with held or bounded parameters.

        Args:
            choice: the model.

        Raises:
            InputError: the selection cannot be fitted.
        """
        channel, names = self.study.channel(choice.channel), choice.effects
        if self.study.is_fitted(channel, names) or choice.held or choice.bounds:
            return None
        stages = [self.study.preview(channel, names[:count]) for count in range(len(names) + 1)]
        return self._shown(choice, stages, is_rough=True)

    def choose(self, choice: ModelSelection) -> DisplayedFit:
        """Fit a selection and make it the current one; nothing changes if it cannot be fitted.

        Args:
            choice: channel, effects and held parameters.

        Raises:
            InputError: the selection cannot be fitted.
        """
        shown = self.show(choice)
        self.set_choice(choice)
        return shown

    def set_choice(self, choice: ModelSelection) -> None:
        """Make a selection the current one without a fit; undo restores the previous one.

        Args:
            choice: channel, effects and held parameters.
        """
        self._moved_slider = ""
        if choice != self.choice:
            self._past.append(self._step)
            self._future.clear()
            self.choice = choice

    def move_slider(self, name: str, value: float) -> None:
        """Store a moved slider's value: one step of undo until `release`.

        Args:
            name: "effect.parameter".
            value: value in the parameter's SI unit.
        """
        if self.choice.slider_values.get(name) == value:  # the browser sends it twice
            return
        choice = replace(self.choice, slider_values={**self.choice.slider_values, name: value})
        if self._moved_slider == name:
            self.choice = choice
        else:
            self.set_choice(choice)
            self._moved_slider = name

    def release(self) -> None:
        """Store that the slider was released."""
        self._moved_slider = ""

    def toggled(self, effect: str) -> ModelSelection:
        """Return the selection with an effect added, or removed if it is selected.

        Args:
            effect: name of the effect.
        """
        now = self.choice.effects
        others = [name for name in now if name != effect]
        return self.choice.with_effects(others if effect in now else [*now, effect])

    def with_held(self, name: str, value: float | None) -> ModelSelection:
        """Return the selection with a parameter held at a value, or free.

        Args:
            name: "effect.parameter".
            value: value in the parameter's SI unit; None to free it.
        """
        held, bounds = _without(self.choice.held, name), _without(self.choice.bounds, name)
        held |= {} if value is None else {name: value}
        return replace(self.choice, held=held, bounds=bounds, slider_values={})

    def with_bounds(self, name: str, bounds: Bounds) -> ModelSelection:
        """Return the selection with a parameter bounded.

        Args:
            name: "effect.parameter".
            bounds: lower and upper bound, in the parameter's SI unit.

        Raises:
            InputError: the bounds are not two numbers, or the lower one is not below the upper one.
        """
        if not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
            low, high = ("empty" if np.isnan(bound) else f"{bound:g}" for bound in bounds)
            raise InputError(
                f"{name}: the bounds are {low} and {high}; give two numbers, the first below the second"
            )
        held = _without(self.choice.held, name)
        return replace(self.choice, held=held, bounds={**self.choice.bounds, name: bounds}, slider_values={})

    @property
    def can_undo(self) -> bool:
        """Whether there is a step to undo."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether a step was undone."""
        return bool(self._future)

    def undo(self) -> "WorkbenchState":
        """Undo one step.

        Returns:
            This state, or another state of the same measurement if the last step changed the use of runs.
        """
        return self._moved(self._past, self._future)

    def redo(self) -> "WorkbenchState":
        """Redo one step; see `undo`."""
        return self._moved(self._future, self._past)

    def _moved(self, source: MutableSequence[_Step], target: MutableSequence[_Step]) -> "WorkbenchState":
        self._moved_slider = ""
        if not source:
            return self
        target.append(self._step)
        choice, runs = source.pop()
        state = self if runs == self._step[1] else self._using(*runs)
        state.choice, state._past, state._future = choice, self._past.copy(), self._future.copy()
        return state

    @property
    def _step(self) -> _Step:
        return self.choice, (self.out, self.study.held_out)

    def to_channel(self, name: str) -> DisplayedFit:
        """Select another channel, with the effects that were last added to it."""
        return self.choose(self._start_of(name))

    def to_revision(self, revision: Revision) -> DisplayedFit:
        """Select a saved revision.

        Args:
            revision: revision saved in the study's folder.

        Raises:
            InputError: the revision is of other data or of another base model.
        """
        self.study.check(revision)
        if self.study.channel(revision.channel).model.name != revision.model:
            raise InputError(
                f"revision {revision.number} starts from {revision.model}: open the page with "
                f"--model {revision.model}"
            )
        return self.choose(ModelSelection(revision.channel, tuple(revision.effects)))

    def save_revisions(self) -> tuple[Revision, ...]:
        """Save the selected effects as revisions, as `palpate add --fresh` does, without held values."""
        if not self.choice.effects:
            raise InputError("nothing has been added yet: tick an effect first")
        return self.study.add(*self.choice.effects, channel=self.choice.channel, fresh=True).revisions

    @property
    def use_of_runs(self) -> str:
        """Runs that are left out or held out, in parentheses; empty if there are none."""
        uses = (("left out", self.out), ("held out", self.study.held_out))
        parts = [f"runs {use}: {_listed(runs)}" for use, runs in uses if runs]
        return f" ({'; '.join(parts)})" if parts else ""

    @property
    def is_saved(self) -> bool:
        """Whether the newest revision has the chosen effects."""
        newest = self.study.latest(self.channel)
        return newest is not None and tuple(newest.effects) == self.choice.effects

    def parameter(self, name: str) -> Parameter:
        """Return facts about a parameter of the selected model that need no fit.

        Args:
            name: "effect.parameter".
        """
        model = self.study.fit(self.channel, self.choice.effects).model
        return {**model.gains, **model.inner}[name]

    def joined_with(self, path: Path) -> "WorkbenchState":
        """Return a state, in memory, with the runs of another session after those of this one.

        Args:
            path: path of the other session.

        Raises:
            InputError: the session cannot be read, or has no channel of this one.
        """
        return self._with(joined(self.study.source, open_source(path)), self.study.held_out)

    def with_runs(self, out: Sequence[int], held_out: Sequence[int]) -> "WorkbenchState":
        """Return a state of the same measurement with a different use of its runs.

        Its revisions and diagnosis are saved in the same folder, as those of a command with `--where` are.

        Args:
            out: runs excluded from fitting and scoring.
            held_out: runs excluded from fitting and used only for scoring; empty to hold out each run in
                turn.

        Raises:
            InputError: a channel would have no runs left, or none to fit.
        """
        state = self._using(tuple(sorted(out)), tuple(sorted(set(held_out) - set(out))))
        state.choice = ModelSelection(self.choice.channel, self.choice.effects)
        state._past = deque([*self._past, self._step], _MOST_STEPS)
        state._future = []
        return state

    def _using(self, out: tuple[int, ...], held_out: tuple[int, ...]) -> "WorkbenchState":
        whole = self.whole or self
        if not out and held_out == whole.study.held_out:
            return whole
        source = whole.study.source.without(out)
        if not all(map(len, source.channels)):
            raise InputError("keep at least one run of each channel")
        state = self._with(source, held_out, whole.study.folder)
        state.source, state.whole, state.out = self.source, whole, out
        return state

    def _with(
        self, source: DataSource, held_out: Sequence[int], folder: Path | None = None
    ) -> "WorkbenchState":
        """Return a state of other data with the same base model and effects."""
        model, own = self.study.model, self.study.user_effects
        state = WorkbenchState(Study(source, model, effects=own, folder=folder, held_out=held_out))
        state.choice = ModelSelection(self.choice.channel, self.choice.effects)
        return state

    def command(self) -> str:
        """Command with the same result as the page; empty if there is none."""
        measured = self.study.source
        if (self.out and measured.session is None) or self.choice.held or self.choice.bounds:
            return ""
        # The command would average other runs.
        if not self.source or (self.whole is not None and measured.averaged):
            return ""
        source = f"{self.source} --where run={_listed(measured.runs)}" if self.out else self.source
        held = self.study.held_out
        source += f" --held-out {_listed(held)}" if held else ""
        model, where = self.channel.model.name, f"--channel {as_shell_word(self.choice.channel)}"
        if not self.choice.effects:
            return f"palpate compare {source} --model {model} {where}"
        return f"palpate add {source} {' '.join(self.choice.effects)} --fresh --model {model} {where}"

    def python(self) -> str:
        """Python line with the same result as the page."""
        if not (self.out or self.study.held_out):
            return self._python()
        source = f"study.source.without({list(self.out)})" if self.out else "study.source"
        model = f", model={self.study.model!r}" if self.study.model else ""
        own = ", effects=study.user_effects" if self.study.user_effects else ""
        held = f", held_out={list(self.study.held_out)}" if self.study.held_out else ""
        return f"study = palpate.Study({source}{model}{own}{held}); " + self._python()

    def _python(self) -> str:
        effects = "".join(f'"{name}", ' for name in self.choice.effects)
        channel = f'"{self.choice.channel}"'
        if self.choice.held or self.choice.bounds:
            given = [f"held={dict(self.choice.held)!r}"] * bool(self.choice.held)
            given += [f"bounds={dict(self.choice.bounds)!r}"] * bool(self.choice.bounds)
            names = f"[{effects.removesuffix(', ')}]"
            return f"study.fit_held({channel}, {names}, {', '.join(given)})"
        if not effects:
            return f"study.compare({channel})"
        return f"study.add({effects}channel={channel}, fresh=True)"

    def _start_of(self, name: str) -> ModelSelection:
        newest = self.study.latest(self.study.channel(name))
        own = () if newest is None or newest.user_effects else tuple(newest.effects)
        return ModelSelection(name, own)


@dataclass(frozen=True)
class EffectEvidence:
    """Change of the error if one effect is added to, or removed from, the other selected effects."""

    effect: str  # its name
    falls: float  # decrease as a share of the held-out error
    # Change of the block residuals, (m,), unit length; parallel for indistinguishable effects.
    change: FloatArray


ALIKE = 0.95  # cosine above which two effects are indistinguishable on these data
TELLING = 0.05  # share of the error below which an effect has no influence


def evidence_of(
    study: Study, channel: StudyChannel, base_effects: Sequence[str], effect: str
) -> EffectEvidence:
    """Compute how one effect changes the error, given others; raise `InputError` if that cannot be fitted.

    Args:
        study: study with the fits.
        channel: channel of the study.
        base_effects: names of the other effects in the model.
        effect: name of the effect.
    """
    before, fitted = study.fit(channel, base_effects), study.fit(channel, [*base_effects, effect])
    change = before.residual_on_blocks - fitted.residual_on_blocks
    length = float(np.linalg.norm(change))
    return EffectEvidence(
        effect, 1.0 - fitted.rmse / before.rmse, change / length if length > 0.0 else change
    )


def groups(evidence: Sequence[EffectEvidence]) -> list[list[EffectEvidence]]:
    """Group effects that are alike on these data, the strongest evidence first.

    Effects are alike if both have an influence and the cosine of their changes exceeds `ALIKE` in size.

    Args:
        evidence: evidence for each effect, given the same other effects.
    """
    left = sorted(evidence, key=lambda each: -each.falls)
    made: list[list[EffectEvidence]] = []
    while left:
        first = left[0]
        alike = [
            each
            for each in left
            if each is first
            or (min(each.falls, first.falls) > TELLING and abs(float(each.change @ first.change)) > ALIKE)
        ]
        made.append(alike)
        left = [each for each in left if each not in alike]
    return made


def _without(values: Mapping[str, Value], name: str) -> dict[str, Value]:
    return {key: value for key, value in values.items() if key != name}


def _listed(runs: Sequence[int]) -> str:
    return ",".join(map(str, runs))
