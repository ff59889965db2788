"""Effects tried beside a model: which are, how well each does, whether its parameters make sense."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.budget.laws import unseen_kinds
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import reading_error
from palpate.estimation.effect import Effect, Inner, SensorEffect
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.elastic_shape import ToolCompliance
from palpate.estimation.fit.blocks import HEAVY
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.inner_search import (
    GridSearch,
    grid_search,
    optimize_inner,
    refine_inner,
    search_inner,
)
from palpate.estimation.fit.intervals import inner_slopes
from palpate.estimation.model import Model
from palpate.estimation.signals.runwise import finest_step
from palpate.robot_io.types import BoolArray

PROMISING = 0.3  # of what the best candidate takes away at its starts; those below are not refined
REFINED = 5  # candidates that are refined in any case
ESSENTIAL = 0.02  # of the squared error: what makes an effect what it is must take away as much
FAR_END = 0.99  # of the upper bound of an inner parameter
_STEP = 1e-4  # of the range of positions, over which a slope is taken
_SNAPPING = 0.01  # of the samples; one at a corner of the law may be as steep
OF_RUNS = "run_"  # begins the names of effects that differ from run to run: runs held out cannot judge them

# Parts of base models, or other names of a term that the channel's own vocabulary has.
_NOT_TRIED = {
    ChannelKind.CONTACT: frozenset({"inertia", "pendulum"}),
    ChannelKind.REVOLUTE: frozenset({"inertia", "pendulum", "stiffness", "damping"}),
    ChannelKind.PRISMATIC: frozenset({"inertia", "stiffness", "damping"}),
    ChannelKind.SERVO: frozenset({"inertia", "stiffness", "damping"}),
}
_BASES = frozenset({"rigid_body", "rigid_body_fitted"})


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried beside a model."""

    effect: Effect  # what was tried
    search: GridSearch  # how well it did
    possible: bool = True  # whether its parameters made physical sense, see `is_possible`

    @property
    def held_out(self) -> float:
        """Sum of squared residuals in held-out runs."""
        return float(self.search.held_out.sum())

    def followed(self, problem: FitProblem) -> float:
        """The same if the inner parameters of the whole model followed, to first order.

        A model without an effect has taken what it could of it on itself: held where they are, its
        parameters would leave the effect little to explain.

        Args:
            problem: to which the candidate was fitted.
        """
        best = self.search.best
        best = solve_gains(problem, best.model, best.parameters)  # with its blocks
        return min(held_out_of_all(problem, best), self.held_out)


def held_out_of_all(problem: FitProblem, solution: Solution) -> float:
    """Sum of squared residuals in runs that tell no parameter at all, to first order.

    Inner parameters are fitted to all runs. Held where they are while gains are fitted fold by fold, they
    would let a law with many of them seem better than one of the same curve with as many gains.

    Args:
        problem: where.
        solution: with its blocks.
    """
    names = (*solution.model.gains, *solution.model.inner)
    columns = np.column_stack([solution.columns, *inner_slopes(problem, solution)])
    fit = problem.solve(columns, solution.target, names, solution.model.held, solution.model.gain_bounds)
    return float(fit.held_out.sum())


def effect_library() -> tuple[Effect, ...]:
    """One of every effect that palpate knows."""
    return tuple(effect() for effect in EFFECTS.values())


def parameter_count(effect: Effect) -> int:
    """Number of an effect's parameters.

    Args:
        effect: in any form.
    """
    return len(effect.inner) + len(effect.gains)


def applicable_effects(data: ChannelData, model: Model, effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The effects that can be tried on this channel beside what the model has.

    Args:
        data: the channel.
        model: the model to extend.
        effects: the library.
    """
    present = {effect.name for effect in model.effects}
    # a tilt turns a weight that is there; beside one, what else goes round with the angle is a tilt
    skipped = _NOT_TRIED[data.kind] | _BASES | present | {"weight" if present & HEAVY else "gravity_tilt"}
    unseen = unseen_kinds(data)
    return tuple(
        effect.suited_to(data)
        for effect in effects
        if effect.name not in skipped
        and not effect.name.startswith(OF_RUNS)
        and unseen.isdisjoint({effect.kind} | effect.also)
        and effect.applies_to(data)
    )


def screen_effects(
    fit: FitResult,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] = lambda share, what: None,
    *,
    starts: Callable[[Effect], Sequence[Inner]] | None = None,
    refined: int = REFINED,
) -> list[Candidate]:
    """Try each effect beside a model, the best in held-out runs first.

    All are tried at their starts, those that do well there also in between. What would be impossible beside
    the other parameters as they were may be possible once all are fitted together.

    Args:
        fit: the model.
        effects: what to try.
        progress: told the share that is done, and what is being tried.
        starts: inner parameters at which to try an effect; by default those that it proposes.
        refined: effects that are tried in between in any case; 0 for none at all.
    """
    # Effects are tried beside the fitted parameters, and as if an offset (which may be zero) were zero.
    inner, known = fit.solution.model.inner, fit.solution.parameters
    zero = {name: 0.0 for name, parameter in inner.items() if parameter.lower < 0.0 < parameter.upper}
    looked, places = [], [known, *([{**known, **zero}] if zero else [])]
    for number, effect in enumerate(effects):
        progress(number / len(effects), effect.name)
        places_of = starts(effect) if starts else effect.starts(fit.data)
        tried = [
            search_inner(fit.problem, model, effect, parameters, places_of)
            for model in extended_models(fit.solution.model, effect)
            for parameters in places
        ]
        looked.append(min(tried, key=lambda one: one.best.sse))
    gains = np.array([fit.solution.sse - tried.best.sse for tried in looked])
    worst = np.sort(gains)[-refined:].min(initial=np.inf) if refined else np.inf
    least = min(PROMISING * gains.max(initial=0.0), worst) if refined else np.inf
    found = []
    for effect, first, gain in zip(effects, looked, gains, strict=True):
        best = refine_inner(fit.problem, first.best.model, effect, first) if gain >= least else first
        possible = is_possible(effect, best.best, fit.problem)
        if not possible and gain >= PROMISING * gains.max():
            best = grid_search((*best.solutions, optimize_inner(fit.problem, best.best)), best.start_count)
            possible = is_possible(effect, best.best, fit.problem)
        found.append(Candidate(effect, best.without_blocks(), possible))
    return sorted(found, key=lambda candidate: candidate.held_out)


def extended_models(model: Model, effect: Effect) -> list[Model]:
    """The model with one more effect, in each of its forms.

    What a sensor does may come before or after what it already does.

    Args:
        model: the model to extend.
        effect: the further effect.
    """
    after = [model.with_effect(form) for form in effect.forms()]
    if isinstance(effect, SensorEffect) and any(isinstance(e, SensorEffect) for e in model.effects):
        return [*after, *(model.with_effect_first(form) for form in effect.forms())]
    return after


def is_possible(effect: Effect, solution: Solution, problem: FitProblem) -> bool:
    """Whether an effect's inner parameters make physical sense, and what makes it what it is is there.

    Args:
        effect: part of the model.
        solution: of the model.
        problem: where.
    """
    # what ended at the far end of a range that goes by ratio was not found
    if any(
        p.log and solution.parameters[f"{effect.name}.{p.name}"] > FAR_END * p.upper for p in effect.inner
    ):
        return False
    # no time stamp is better than half a step
    times = [abs(solution.parameters[f"{effect.name}.{p.name}"]) for p in effect.inner if p.unit == "s"]
    if times and min(times) < 0.5 * finest_step(problem.blocked.data.time_s, problem.blocked.data.run):
        return False
    # A path below half a step, the most that rounding puts a position off by, is none.
    if effect.path and solution.parameters[f"{effect.name}.{effect.path}"] ** 2 < 3.0 * np.mean(
        reading_error(problem.blocked.data) ** 2
    ):
        return False
    simpler = effect.simpler(solution.columns[:, _is_own(effect, solution)])
    if simpler.shape[1] == len(effect.gains):
        return True
    others = solution.columns[:, ~_is_own(effect, solution)]
    without = problem.solve(np.column_stack([others, simpler]), solution.target)
    return float(without.sse.sum()) - solution.sse >= ESSENTIAL * solution.sse


def is_misnamed(effect: Effect, solution: Solution, problem: FitProblem) -> bool:
    """Whether the effect has become another thing than its name says, see `Effect.is_misnamed`.

    Args:
        effect: an effect of the model.
        solution: the fitted model.
        problem: to which it was fitted.
    """
    if effect.name == ToolCompliance.name and _snaps(solution, problem):
        return True
    data = solution.model.moved(problem.blocked.data, solution.parameters)
    noise = float(np.sqrt(np.mean(solution.residual**2)))
    return effect.is_misnamed(data, solution.parameters, lambda: solution.standard_errors, noise)


def _snaps(solution: Solution, problem: FitProblem) -> bool:
    """Whether the object softens by more than the tool's compliance in series can follow: the tip would snap.

    There the force is no function of the displacement, and a motion that is corrected by the measured force
    follows this force, whatever it is. The object's slope counts as deep as the tip went.
    """
    data, parameters, model = problem.blocked.data, solution.parameters, solution.model
    rigid, compliance = model.without(ToolCompliance.name), parameters[f"{ToolCompliance.name}.compliance"]
    deepest = float(np.max(data.position - compliance * data.effort))
    data = data.select(data.engaged & (data.position <= deepest))
    if len(data) == 0:
        return False
    step = _STEP * deepest
    further = replace(data, position=data.position + step)
    slope = (rigid.predict(further, parameters) - rigid.predict(data, parameters)) / step
    return float(np.mean(1.0 + compliance * slope < 0.0)) > _SNAPPING


def _is_own(effect: Effect, solution: Solution) -> BoolArray:
    return np.array([name.startswith(f"{effect.name}.") for name in solution.model.gains], dtype=np.bool_)
