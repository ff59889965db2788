"""Screen candidate effects that extend a fitted model, and check fitted parameters for plausibility."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from palpate.estimation.budget.laws import unseen_kinds
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.effect import Effect, Inner, SensorEffect, forms_of
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.elastic_shape import ToolCompliance
from palpate.estimation.effects.sensor_dynamics import Lag
from palpate.estimation.effects.sensor_statics import Saturation
from palpate.estimation.fit.blocks import HEAVY
from palpate.estimation.fit.fit_problem import FitProblem, Solution, columns_at, linearize_inner, solve_gains
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.inner_search import (
    GridSearch,
    grid_search,
    optimize_inner,
    refine_inner,
    search_inner,
)
from palpate.estimation.fit.intervals import inner_slopes
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.kinds import Kind
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.signals.cache_by_array import IdentityKey
from palpate.estimation.signals.runwise import finest_step, longest_run, sample_time
from palpate.robot_io.types import FloatArray

PROMISING = 0.3  # least improvement, relative to the best candidate's, at which a candidate is refined
REFINED = 5  # number of candidates that are always refined
ESSENTIAL = 0.02  # least share of the squared error that the characteristic part of an effect must explain
_FEW_STARTS = 4  # start values in a quick screening
_FAR_END = 0.99  # share of the upper bound above which a logarithmic parameter is undetermined
# Multiple of the range of motion, the longest run, or the largest speed or effort, above which a parameter is
# undetermined, depending on its unit; for the largest effort, also the multiple for an effect's own effort.
_FAR = 10.0
_STEP = 1e-4  # step of a finite difference, relative to the deepest indentation
_MAX_UNSTABLE = 0.01  # tolerated share of unstable samples, since a corner of the law may be as steep
_AT_LIMIT = 3.0  # distance from the limit, relative to the residual, within which a reading may be saturated
# Largest ratio of the squared distances of predictions below and beyond a limit; it is 1 for a held force.
_BOTH_SIDES = 0.25
_MOST_OF_LAG = (
    0.5  # largest share of what a lag explains that may be its response to the effort before the runs
)
RUN_PREFIX = "run_"  # prefix of effects that vary between runs; held-out runs cannot test them as candidates

# Parts of base models, and effects that have another name for this kind of channel.
_EXCLUDED = {
    ChannelKind.CONTACT: frozenset({"pendulum"}),
    ChannelKind.REVOLUTE: frozenset({"inertia", "pendulum", "stiffness", "damping"}),
    ChannelKind.PRISMATIC: frozenset({"inertia", "stiffness", "damping"}),
    ChannelKind.SERVO: frozenset({"inertia", "stiffness", "damping"}),
}
# Signals that are unknown in steady states.
_MOTION_SIGNALS = frozenset({"position", "acceleration", "past motion", "time"})
_BASES = frozenset({"rigid_body", "rigid_body_fitted"})


@dataclass(frozen=True)
class Candidate:
    """An effect that was fitted as an extension of a model."""

    effect: Effect
    search: GridSearch  # fits at the tried inner parameters
    possible: bool = True  # whether its parameters are plausible, see `is_possible`

    @property
    def held_out(self) -> float:
        """Sum of squared residuals in held-out runs [effort^2]."""
        return float(self.search.held_out.sum())

    def error_with_adapted_inner(self, problem: FitProblem) -> float:
        """Return the squared held-out error with inner parameters adapted to the candidate, to first order.

        The model's inner parameters, fitted without the candidate, have absorbed a part of its effect.

        Args:
            problem: the problem to which the candidate was fitted.
        """
        best = self.search.best
        best = solve_gains(problem, best.model, best.parameters)  # restores the arrays on blocks
        return min(cross_validated_error(problem, best), self.held_out)


def cross_validated_error(problem: FitProblem, solution: Solution) -> float:
    """Compute the sum of squared residuals with all parameters fitted without the held-out fold [effort^2].

    Only gains are fitted without each fold, which favors laws with many inner parameters. Derivatives by the
    inner parameters are therefore added as columns: a cross-validation of all parameters to first order.

    Args:
        problem: the fit problem.
        solution: its solution, with arrays on blocks.
    """
    names = (*solution.model.gains, *solution.model.inner)
    columns = np.column_stack([solution.columns, *inner_slopes(problem, solution)])
    fit = problem.solve(columns, solution.target, names, solution.model.held, solution.model.gain_bounds)
    return float(fit.held_out.sum())


def effect_library() -> tuple[Effect, ...]:
    """Instantiate every effect of the library."""
    return tuple(effect() for effect in EFFECTS.values())


def parameter_count(effect: Effect) -> int:
    """Return the number of an effect's parameters (gains and inner parameters).

    Args:
        effect: the effect, in any of its forms.
    """
    return len(effect.inner) + len(effect.gains)


def determined_count(effect: Effect, solution: Solution, problem: FitProblem) -> int:
    """Return the number of an effect's parameters that the data determine.

    An inner parameter is undetermined if its standard error, with all other parameters known, exceeds its
    value: in a motion that never reverses, the transition of dry friction changes nothing.

    Args:
        effect: an effect of the model.
        solution: the fitted model.
        problem: the problem to which it was fitted.
    """
    if not effect.inner:
        return parameter_count(effect)
    solution = solve_gains(problem, solution.model, solution.parameters)  # restores the arrays on blocks
    sigma = np.sqrt(np.mean(problem.whiten(solution.residual) ** 2))
    slopes = dict(zip(solution.model.inner, inner_slopes(problem, solution), strict=True))
    names = [f"{effect.name}.{parameter.name}" for parameter in effect.inner]
    changes = [np.linalg.norm(problem.whiten(slopes[name] * solution.parameters[name])) for name in names]
    return len(effect.gains) + sum(bool(change > sigma) for change in changes)


def applicable_effects(data: ChannelData, model: Model, effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Select the effects of a library that can extend the model of a channel.

    Args:
        data: the channel.
        model: the model to extend.
        effects: the library.
    """
    present = {effect.name for effect in model.effects}
    # If the model has a weight, a tilt changes its direction. Otherwise a tilt would be an arbitrary term in
    # sin and cos.
    skipped = _EXCLUDED[data.kind] | _BASES | present | {"weight" if present & HEAVY else "gravity_tilt"}
    unseen, unknown = unseen_kinds(data), _MOTION_SIGNALS if data.is_steady else frozenset[str]()
    return tuple(
        effect.suited_to(data)
        for effect in effects
        if effect.name not in skipped
        and not effect.name.startswith(RUN_PREFIX)
        and unseen.isdisjoint({effect.kind} | effect.also)
        and unknown.isdisjoint(effect.signals)
        and effect.applies_to(data)
    )


def screen_effects(
    fit: FitResult,
    effects: Sequence[Effect],
    progress: Callable[[float, str], None] = lambda share, what: None,
    *,
    starts: Callable[[Effect], Sequence[Inner]] | None = None,
    refined: int = REFINED,
    restarted: Collection[str] = (),
) -> list[Candidate]:
    """Fit each effect as an extension of a model; return candidates, the lowest held-out error first.

    Each effect is fitted at its start values; promising effects are then refined between these values. An
    effect with impossible parameters is marked as impossible only after a joint fit with the others.

    Args:
        fit: the fitted model.
        effects: the candidate effects.
        progress: callback that receives the completed share and the name of the current effect.
        starts: returns start values of an effect's inner parameters; by default `Effect.starts`.
        refined: number of effects that are always refined; 0 refines none.
        restarted: effects of the model that are also tried at their own start values, since they may imitate
            a missing effect, as dry friction with a wide transition imitates viscous friction.
    """
    # Start at the fitted parameters, and at the same with offsets (parameters that may be zero) set to zero.
    inner, known = fit.solution.model.inner, fit.solution.parameters
    zero = {name: 0.0 for name, parameter in inner.items() if parameter.lower < 0.0 < parameter.upper}
    searches, parameter_sets = [], [known, *([{**known, **zero}] if zero else [])]
    for name in restarted:
        parameter_sets += [
            {**known, **{f"{name}.{parameter}": value for parameter, value in start.items()}}
            for start in _few_starts(fit.solution.model.effect(name), fit.data)
        ]
    for number, effect in enumerate(effects):
        progress(number / len(effects), effect.name)
        start_values = starts(effect) if starts else effect.starts(fit.data)
        tried = [
            search_inner(fit.problem, model, effect.name, parameters, start_values)
            for model in extended_models(fit.solution.model, effect)
            for parameters in parameter_sets
        ]
        searches.append(min(tried, key=lambda search: search.best.sse))
    gains = np.array([fit.solution.sse - search.best.sse for search in searches])
    worst = np.sort(gains)[-refined:].min(initial=np.inf) if refined else np.inf
    least = min(PROMISING * gains.max(initial=0.0), worst) if refined else np.inf
    candidates = []
    for effect, first, gain in zip(effects, searches, gains, strict=True):
        best = refine_inner(fit.problem, effect.name, first) if gain >= least else first
        possible = is_possible(effect, best.best, fit.problem)
        if not possible and gain >= PROMISING * gains.max():
            best = grid_search((*best.solutions, optimize_inner(fit.problem, best.best)), best.start_count)
            possible = is_possible(effect, best.best, fit.problem)
        candidates.append(Candidate(effect, best.without_blocks(), possible))
    return sorted(candidates, key=lambda candidate: candidate.held_out)


def quick_screen(parent: FitResult, effects: Sequence[Effect]) -> list[Candidate]:
    """Fit extensions of a model at few start values; return the possible ones, the best first.

    Args:
        parent: the model to extend.
        effects: the candidate effects.
    """
    starts = partial(_few_starts, data=parent.data)
    screened = screen_effects(parent, effects, starts=starts, refined=0)
    return [candidate for candidate in screened if candidate.possible]


def _few_starts(effect: Effect, data: ChannelData) -> Sequence[Inner]:
    starts = effect.starts(data)
    return starts[:: max(len(starts) // _FEW_STARTS, 1)]


def extended_models(model: Model, effect: Effect) -> list[Model]:
    """Extend a model by each form of an effect; a sensor effect also before the model's sensor effects.

    Args:
        model: the model to extend.
        effect: the effect to add.
    """
    forms = forms_of(IdentityKey(effect))
    after = [model.with_effect(form) for form in forms]
    if isinstance(effect, SensorEffect) and any(isinstance(e, SensorEffect) for e in model.effects):
        return [*after, *(model.with_effect(form, first=True) for form in forms)]
    return after


def start_columns(fit: FitResult, effect: Effect) -> Iterator[FloatArray]:
    """Yield the columns (m, q) of a model that an effect extends, at each of the effect's start values.

    Args:
        fit: the fitted model.
        effect: the effect to add.
    """
    known = fit.solution.parameters
    for model in extended_models(fit.solution.model, effect):
        parts_at = linearize_inner(fit.problem.blocked, model, effect, known)
        for start in effect.starts(fit.data):
            values = {**known, **{f"{effect.name}.{name}": value for name, value in start.items()}}
            yield columns_at(fit.problem, model, values, parts_at(start))


def is_possible(effect: Effect, solution: Solution, problem: FitProblem) -> bool:
    """Check that an effect's parameters and effort are plausible and its essential gains explain enough.

    Args:
        effect: an effect of the model.
        solution: the fitted model.
        problem: the problem to which it was fitted.
    """
    data = problem.blocked.data
    # Sampling does not resolve times below half a step.
    shortest = {"s": 0.5 * finest_step(data.time_s, data.run)}
    largest = {
        "s": longest_run(data.time_s, data.run),
        "{position}": data.range_of_motion,
        "{position}/s": float(np.max(np.abs(data.velocity))) or 1.0,
        "{effort}": data.largest_effort,
    }
    for parameter in effect.inner:
        size = abs(solution.parameters[f"{effect.name}.{parameter.name}"])
        low, high = shortest.get(parameter.unit, 0.0), _FAR * largest.get(parameter.unit, np.inf)
        high = min(high, _FAR_END * parameter.upper) if parameter.log else high
        if not low <= size <= high:
            return False
    is_own = np.array([name.startswith(f"{effect.name}.") for name in solution.model.gains], dtype=np.bool_)
    # Efforts far larger than their sum come from collinear columns (Belsley, Kuh, Welsch, Wiley 1980),
    # which imitate a third law: a weight and a spring over a small angle imitate a cubic spring.
    gains = np.array([solution.parameters[name] for name in solution.model.gains])
    own_effort = solution.columns[:, is_own] @ gains[is_own]
    if np.mean(own_effort**2) > (_FAR * data.largest_effort) ** 2:
        return False
    simpler = effect.simpler(solution.columns[:, is_own])
    if simpler.shape[1] == len(effect.gains):
        return True
    others = solution.columns[:, ~is_own]
    without = problem.solve(np.column_stack([others, simpler]), solution.target)
    return float(without.sse.sum()) - solution.sse >= ESSENTIAL * solution.sse


def is_misnamed(effect: Effect, solution: Solution, problem: FitProblem) -> bool:
    """Return whether the fitted effect imitates another effect, see `Effect.is_misnamed`.

    Args:
        effect: an effect of the model.
        solution: the fitted model.
        problem: the problem to which it was fitted.
    """
    if effect.name == ToolCompliance.name and _snaps(solution, problem):
        return True
    if effect.kind is Kind.SENSOR_DYNAMICS and _lowers_error_only_at_reversals(effect, solution, problem):
        return True
    if effect.name == Saturation.name and _is_held_at_limit(solution, problem):
        return True
    if effect.name == Lag.name and _is_initial_response(solution, problem):
        return True
    read = problem.blocked.data
    step = read.position_step or grid_step(read.position)  # a shifted motion is not on the grid
    data = replace(solution.model.moved(read, solution.parameters), position_step=step)
    noise = float(np.sqrt(np.mean(solution.residual**2)))
    return effect.is_misnamed(data, solution.parameters, lambda: solution.standard_errors, noise)


def _lowers_error_only_at_reversals(effect: Effect, solution: Solution, problem: FitProblem) -> bool:
    """Return whether a delay or a lag, beside friction, lowers the error only where the motion reverses.

    No law of friction is exact there: a joint sticks, and smoothing rounds the velocity. A sensor's delay or
    lag acts on all readings.
    """
    model, blocked = solution.model, problem.blocked
    if all(other.kind is not Kind.FRICTION for other in model.effects):
        return False
    data, block = blocked.data, blocked.rows.shape[1]
    halves = (half for half in identify_measurement_model(data).filters if half is not None)
    delay_s = sum(abs(solution.parameters[f"{effect.name}.{parameter.name}"]) for parameter in effect.inner)
    reach = 1 + int(np.ceil((max(halves, default=0) + delay_s / sample_time(data.time_s, data.run)) / block))
    forward = blocked.reduce(data.velocity) > 0.0
    reverses = np.diff(forward, prepend=forward[:1]) & (np.diff(blocked.run, prepend=blocked.run[:1]) == 0)
    away = problem.used & ~scipy.ndimage.binary_dilation(reverses, iterations=reach)
    without = solve_gains(problem, model.without(effect.name), solution.parameters)
    return bool(away.any() and np.sum(without.residual[away] ** 2) <= np.sum(solution.residual[away] ** 2))


def _is_held_at_limit(solution: Solution, problem: FitProblem) -> bool:
    """Return whether saturation imitates a force that a controller holds at one value.

    The model fitted to the readings below the limit predicts the others. Errors of the measured motion move
    the prediction of a held force to both sides of its value. A sensor cuts off only what exceeds its limit.
    """
    blocked, limit = problem.blocked, solution.parameters[f"{Saturation.name}.limit"]
    lowest = limit - _AT_LIMIT * float(np.sqrt(np.mean(solution.residual**2)))
    below = np.abs(blocked.reduce(blocked.data.effort)) < lowest
    if not (problem.used & below).any():
        return False
    unlimited = solution.model.without(Saturation.name)
    weights = below.astype(np.float64) if problem.weights is None else below * problem.weights
    fitted = solve_gains(replace(problem, weights=weights), unlimited, solution.parameters)
    at_limit = np.abs(blocked.data.effort) >= lowest
    beyond = np.abs(unlimited.predict(blocked.data, fitted.parameters))[at_limit] - limit
    return bool(np.sum(beyond[beyond < 0.0] ** 2) > _BOTH_SIDES * np.sum(beyond[beyond > 0.0] ** 2))


def _is_initial_response(solution: Solution, problem: FitProblem) -> bool:
    """Return whether most of what a lag explains is the response of its filter to the effort before each run.

    This response, an exponential in each run from its first reading on, imitates a relaxation.
    """
    blocked, used, without = problem.blocked, problem.used, solution.model.without(Lag.name)
    data, (starts, run) = blocked.data, block_index(blocked.data.run)
    difference = data.effort[starts] - without.predict(data, solution.parameters)[starts]
    decay = Lag().decay(data, {"tau": solution.parameters[f"{Lag.name}.tau"]})
    response = blocked.reduce(difference[run] * decay)[used]
    reduced = solve_gains(problem, without, solution.parameters)
    explained = np.sum(reduced.residual[used] ** 2) - np.sum(solution.residual[used] ** 2)
    return bool(np.sum(response**2) > _MOST_OF_LAG * explained)


def _snaps(solution: Solution, problem: FitProblem) -> bool:
    """Return whether the object softens too much to be stable with a compliance in series (snap-through)."""
    # With snap-through, a motion corrected by the measured force reproduces this force, whatever its cause.
    data, parameters, model = problem.blocked.data, solution.parameters, solution.model
    rigid, compliance = model.without(ToolCompliance.name), parameters[f"{ToolCompliance.name}.compliance"]
    deepest = float(np.max(data.position - compliance * data.effort))
    data = data.select(data.engaged & (data.position <= deepest))
    if len(data) == 0:
        return False
    step = _STEP * deepest
    deeper = replace(data, position=data.position + step)
    slope = (rigid.predict(deeper, parameters) - rigid.predict(data, parameters)) / step
    return float(np.mean(1.0 + compliance * slope < 0.0)) > _MAX_UNSTABLE
