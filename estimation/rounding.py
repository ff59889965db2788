"""What the steps of an encoder leave uncertain of parameters."""

from dataclasses import replace

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.estimate import Determined, Estimate, Identifiability
from palpate.estimation.fit.samples import slopes_of
from palpate.estimation.model import Model, Parameters
from palpate.estimation.signals.blocks import blocks, number_pieces
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.surface import FEWEST_STEPS
from palpate.robot_io.types import BoolArray, FloatArray

_MANY_STEPS = 1000.0  # from here on, rounding does less than 0.1 %
_DRAWS = 16
_SEED = 1


def mark_coarse(estimate: Estimate, data: ChannelData, rows: BoolArray) -> Estimate:
    """Take the intervals away, and say why, where the motion spans too few steps to know any slope.

    Args:
        estimate: the estimate.
        data: the channel.
        rows: samples that were fitted, a mask of shape (n,).
    """
    steps = steps_spanned(data, rows)
    if steps >= FEWEST_STEPS:
        return estimate
    unknown = float("nan")
    note = (
        f"{in_steps(data, rows)}, too few for a slope: press harder, take a softer object, or a finer encoder"
    )
    parameters = tuple(
        replace(p, std_err=unknown, interval=(unknown, unknown), determined=Determined.NO)
        for p in estimate.parameters
    )
    return replace(
        estimate,
        parameters=parameters,
        covariance=np.full_like(estimate.covariance, unknown),
        identifiability=Identifiability.NONE,
        note=note,
        unphysical=(),
    )


def steps_spanned(data: ChannelData, rows: BoolArray) -> float:
    """How many steps of its grid the position spans in these rows; infinite where it is on none.

    Args:
        data: the channel.
        rows: samples, a mask of shape (n,).
    """
    if data.position_step == 0.0 or not rows.any():
        return float("inf")
    return float(np.ptp(data.position[rows])) / data.position_step


def in_steps(data: ChannelData, rows: BoolArray) -> str:
    """The same in words.

    Args:
        data: the channel.
        rows: samples, a mask of shape (n,).
    """
    steps, length = steps_spanned(data, rows), float(np.ptp(data.position[rows]))
    span = f"{length:.2g} rad" if data.kind is ChannelKind.REVOLUTE else f"{1e3 * length:.2g} mm"
    return f"the press spans {steps:.1f} steps of the encoder ({span})"


def rounding_errors(model: Model, data: ChannelData, rows: BoolArray, parameters: Parameters) -> FloatArray:
    """By how much other places of the grid would have moved the parameters, shape (m, r).

    The residuals do not show it: a hold lies within one step and has one error, steps make a derived velocity
    noisy, and least squares take either for a softer object (R. J. Carroll et al., Measurement Error in
    Nonlinear Models (2006), ch. 3). Therefore the measurement is repeated: the smoothed motion and the effort
    that the model gives it are read through the same grid, moved at random, and fitted again by one step of
    Gauss and Newton.

    Args:
        model: what was fitted.
        data: the channel.
        rows: samples that count, shape (n,).
        parameters: as found, by "effect.parameter".

    Returns:
        Errors of gains and inner parameters, a column a repetition; none where the grid is fine enough.
    """
    if steps_spanned(data, rows) > _MANY_STEPS:
        return np.zeros((len(parameters), 0))
    rng = np.random.default_rng(_SEED)
    smooth = replace(data, position=_smoothed(data))
    effort = model.predict(smooth, parameters)
    pieces = number_pieces(data.time_s, data.run)
    half, errors = None, []
    for shift in (rng.random(_DRAWS) + np.arange(_DRAWS)) / _DRAWS:
        moved = smooth.position + shift * data.position_step
        position = np.round(moved / data.position_step) * data.position_step - shift * data.position_step
        motion = differentiate(data.time_s, position, pieces, half, rounding=data.position_step**2 / 12)
        half = motion.half_windows[0]
        again = replace(data, position=position, velocity=motion.velocity, effort=effort)
        left = effort - model.predict(again, parameters)
        errors.append(solve(slopes_of(model, again, parameters)[rows], left[rows]).gains)
    return np.column_stack(errors)


def _smoothed(data: ChannelData) -> FloatArray:
    """The positions without their steps, shape (n,): the velocity summed up, run by run."""
    position = np.empty(len(data))
    for rows in blocks(number_pieces(data.time_s, data.run)):
        moves = np.diff(data.time_s[rows]) * (data.velocity[rows][1:] + data.velocity[rows][:-1]) / 2
        way = np.concatenate([[0.0], np.cumsum(moves)])
        position[rows] = way + np.mean(data.position[rows] - way)
    return position
