"""Smoothing bias of derived motion: kernels, size, and effect on laws and noise."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.data.derivatives import local_derivative
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.flexible_regression import fit_flexible
from palpate.estimation.fit.smoothing_bias import (
    _is_plausible_bias,
    fit_smoothing_bias,
    is_below_cutoff,
    looks_like_smoothing,
    smoothing_kernel,
)
from palpate.estimation.model import Model
from tests.estimation.swings import INERTIA, NOISE_NM, smoothed, within
from tests.estimation.swings import long_swings as swings

MEASURED = ((), ())  # velocity and acceleration were not derived
SWING = Model("pendulum", (EFFECTS["pendulum"](), EFFECTS["viscous_friction"]()))


def windows(half):
    return ((half, 1),), ((half, 2),)


def errors(data, half, good):
    """Held-out error of the model on blocks, without and with smoothing bias, relative to the noise."""
    fit = fit_model(data, SWING, {}, good)
    _, beside = fit_smoothing_bias(fit.problem, fit.solution, windows(half))
    assert beside is not None
    count, noise = fit.problem.used.sum(), NOISE_NM / np.sqrt(fit.problem.blocked.rows.shape[1])
    return [np.sqrt(left / count) / noise for left in (fit.solution.held_out, beside.held_out.sum())]


@pytest.mark.parametrize("half", [25, 35, 50])
def test_smoothing_bias_of_derived_motion_is_no_law(half):
    data = smoothed(swings(6), half)
    before, after = errors(data, half, within(data, half))
    assert after == pytest.approx(1.0, rel=0.03)
    assert before > 1.1 * after
    fit = fit_model(data, SWING, {}, within(data, half))
    shares = [
        fit_flexible(fit.problem, fit.solution, f).share_of(fit.solution) for f in (windows(half), MEASURED)
    ]
    assert shares[0] < 0.02 < shares[1]


def test_law_is_explained_beside_the_smoothing_bias():
    fit = fit_model(smoothed(swings(6, lambda q, v, a: 0.2 * np.sin(9.0 * q)), 25), SWING, {})
    assert fit_flexible(fit.problem, fit.solution, windows(25)).share_of(fit.solution) > 0.7


@pytest.mark.parametrize(
    ("change", "looks"),
    [
        (
            lambda true, derived: 0.05 * (true.acceleration - derived.acceleration),
            True,
        ),  # the inertia's torque
        (lambda true, derived: 0.3 * np.tanh(true.velocity / 0.02), False),  # friction
        (lambda true, derived: 6.0 * derived.position, False),  # a spring
        (lambda true, derived: 0.5 * (true.acceleration - derived.acceleration), False),  # far too large
    ],
)
def test_smoothing_is_told_from_friction_and_springs(change, looks):
    true = swings(6)
    derived = smoothed(true, 25)
    fit = fit_model(derived, SWING, {}, within(derived, 25))
    blocked = fit.problem.blocked
    effort, changed = blocked.effort - fit.solution.residual, blocked.reduce(change(true, derived))
    assert looks_like_smoothing(fit.problem, effort, changed, windows(25)) is looks


def test_narrower_window_of_a_second_derivative_is_expected_to_remove_more():
    true = swings(6)
    derived = replace(smoothed(true, 25), velocity=smoothed(true, 35).velocity)
    fit = fit_model(derived, SWING, {}, within(derived, 35))
    blocked, filters = fit.problem.blocked, (((35, 1),), ((25, 2),))
    removed = blocked.reduce(INERTIA * (true.acceleration - derived.acceleration))
    effort = blocked.effort - fit.solution.residual
    assert looks_like_smoothing(fit.problem, effort, removed, filters)
    assert not looks_like_smoothing(fit.problem, effort, 5.0 * removed, filters)


@pytest.mark.parametrize(
    ("cycles_hz", "is_slow"),
    [(0.5, True), (1.0, True), (4.0, False)],  # the window of 0.2 s halves an acceleration at 4.7 Hz
)
def test_fall_of_a_residual_is_told_by_its_frequency(cycles_hz, is_slow):
    data = smoothed(swings(6), 25)
    problem = fit_model(data, SWING, {}, within(data, 25)).problem
    wave = problem.blocked.reduce(np.sin(2.0 * np.pi * cycles_hz * data.time_s))
    noise = np.random.default_rng(0).normal(0.0, 0.1, len(wave))
    assert is_below_cutoff(problem, wave + noise, noise, windows(25)) is is_slow
    assert is_below_cutoff(problem, wave + noise, noise, windows(1))  # the blocks are longer


@pytest.mark.parametrize(("block", "least", "length"), [(1, 0.01, 43), (4, 0.05, 13)])
@pytest.mark.parametrize("order", [1, 2])
def test_kernel_smooths_like_the_differentiation_window(order, block, least, length):
    t = np.arange(2000) * 0.01
    waves = [(0.3, 0.2), (1.1, 1.3), (2.3, 2.0)]  # frequency [Hz] and phase
    signal = sum(np.sin(2 * np.pi * f * t + phase) / f**order for f, phase in waves)
    exact = sum((2 * np.pi) ** order * np.sin(2 * np.pi * f * t + p + order * np.pi / 2) for f, p in waves)
    derived, exact, signal = (
        s.reshape(-1, block).mean(axis=1) for s in (local_derivative(t, signal, 20, order), exact, signal)
    )
    kernel = smoothing_kernel(20, order, block)
    assert len(kernel) == length  # a block beyond the window on each side
    assert not kernel.flags.writeable  # it is shared by all who ask for it
    inside = slice(len(kernel), -len(kernel))
    smooth, derived, exact = (s[inside] for s in (np.convolve(exact, kernel, mode="same"), derived, exact))
    assert np.std(smooth - derived) < least * np.std(exact - derived)


@pytest.mark.parametrize(
    ("gains", "is_plausible"),
    [
        ((0.0, 3.0), True),  # three times the last column
        ((0.0, -3.0), True),
        ((0.0, 3.01), False),
        ((0.6, 0.0), True),
        ((0.61, 0.0), False),
    ],
)
def test_plausible_smoothing_bias_is_at_most_three_times_expected(gains, is_plausible):
    assert _is_plausible_bias(np.array([[5.0, 1.0], [-5.0, -1.0]]), np.array(gains)) is is_plausible
