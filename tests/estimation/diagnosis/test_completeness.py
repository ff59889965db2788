"""Completeness of a model: its residual compared with bootstrap samples, in `diagnose` and in `compare`."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.diagnosis import completeness
from palpate.estimation.diagnosis.completeness import Completeness
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.measurement_noise import measurement_noise
from palpate.estimation.study.comparison import compare
from tests.estimation.contact_data import channel, swing
from tests.estimation.searches import PRESS, SWING
from tests.estimation.swings import swings


@pytest.mark.parametrize(
    ("exact", "outdone", "rmse", "steps", "unusual", "complete", "drawn"),
    [
        (True, True, 2.0, 0.0, True, True, 0),  # nothing is left
        (False, True, 1.0, 0.0, False, False, 0),  # a law without a name does better
        (False, False, 1.049, 0.0, True, True, 0),  # within a twentieth of the floor
        (False, False, 1.051, 0.0, True, False, 1),
        (False, False, 1.051, 0.0, False, True, 1),  # draws from it show as much
        (False, False, 1.051, 0.31, True, True, 0),  # steps of the position may make as much
        (False, False, 1.051, 0.29, True, False, 1),
    ],
)
def test_model_is_complete_if_its_residual_matches_bootstrap_samples(
    exact, outdone, rmse, steps, unusual, complete, drawn, monkeypatch
):
    fit = Mock(is_exact=exact, rmse=rmse, **{"floor.return_value": 1.0, "flexible.explained": 0.9})
    fit.problem.used = np.ones(10)
    asked = []
    monkeypatch.setattr(completeness, "encoder_step_error", lambda *_: steps)
    monkeypatch.setattr(completeness, "is_outperformed", lambda *_: outdone)
    unlike = SimpleNamespace(is_significant=unusual)
    monkeypatch.setattr(completeness, "lack_of_fit_test", lambda *_: asked.append(1) or unlike)
    monkeypatch.setattr(completeness, "check_residuals", lambda *_, complete: asked.append(complete) or "why")
    monkeypatch.setattr(completeness, "measurement_noise", lambda _: SimpleNamespace(is_bound=False))
    judge = Completeness(SimpleNamespace(training=swings(1, runs=2)), np.random.default_rng(0))
    assert judge.leaves_noise(fit) is judge.leaves_noise(fit) is complete
    assert asked == [1] * drawn  # each model is judged once
    assert judge.residual_finding(fit) == judge.residual_finding(fit) == (None if exact else "why")
    assert asked[drawn:] == ([] if exact else [complete])
    assert judge.is_complete(fit) is (complete and exact)


@pytest.mark.parametrize(("smoothing", "may_cause_it"), [(0.25, True), (0.23, False)])
def test_smoothing_may_cause_a_quarter_more_than_its_first_order_estimate(
    smoothing, may_cause_it, monkeypatch
):
    fit = Mock(**{"flexible.explained": 10 * 0.3**2})
    fit.problem.used = np.ones(10)
    monkeypatch.setattr(completeness, "smoothing_error", lambda *_: smoothing)
    monkeypatch.setattr(completeness, "is_mostly_smoothing", lambda *_: True)
    monkeypatch.setattr(completeness, "measurement_noise", lambda _: SimpleNamespace(is_bound=False))
    judge = Completeness(SimpleNamespace(training=swings(1, runs=2)), np.random.default_rng(0))
    assert judge.leaves_smoothing(fit) is may_cause_it


@pytest.mark.parametrize(
    ("changes", "explains"),
    [
        ({}, True),  # its gains differ between runs, and nothing else is wrong
        ({"finding": None}, False),
        ({"finding": SimpleNamespace(fits_each_run=False)}, False),
        ({"noisy": False}, False),
        ({"bound": True}, False),  # an upper bound of the noise shows nothing
        ({"incomplete": ["fit"]}, False),
        ({"complete": True, "finding": None, "noisy": False, "bound": True}, True),
    ],
    ids=str,
)
def test_each_run_is_explained_by_a_complete_model_or_by_other_gains(changes, explains):
    given = {"complete": False, "incomplete": [], "noisy": True, "bound": False}
    given |= {"finding": SimpleNamespace(fits_each_run=True)} | changes
    checks = SimpleNamespace(
        is_complete=lambda _: given["complete"],
        leaves_noise=lambda _: given["noisy"],
        residual_finding=lambda _: given["finding"],
        incomplete=given["incomplete"],
        _noise=SimpleNamespace(is_bound=given["bound"]),
    )
    assert Completeness.explains_each_run(checks, "fit") is explains


def presses(k3):
    """Three slow presses of a soft object with 500 N/m, 5 N s/m and a cubic stiffness, with noise of 10 mN.

    The depth is read in steps of 0.2 mm, each of which lasts many samples.
    """
    parts = [swing(1500, deepest_m=deepest) for deepest in (0.010, 0.011, 0.012)]
    time_s, depth, velocity = (np.concatenate(part) for part in zip(*parts, strict=True))
    depth = depth + 0.01  # far from the surface, which an object without adhesion would leave when moving out
    time_s, velocity = 10.0 * time_s, 0.1 * velocity
    force = 500.0 * depth + 5.0 * velocity + k3 * depth**3
    measured = force + 0.01 * np.random.default_rng(8).standard_normal(len(force))
    run = np.repeat(np.arange(3), 1500)
    return channel(measured, np.round(depth / 2e-4) * 2e-4, velocity, time_s, run=run)


@pytest.mark.parametrize(("k3", "fits"), [(0.0, True), (1e5, False)])
def test_comparison_finds_nothing_missing_in_errors_of_a_coarse_encoder(k3, fits):
    fitted = fit_model(presses(k3), PRESS, {})
    compared = compare(fitted, fitted, PRESS.name, measurement_noise(fitted))
    assert compared.lack_of_fit > 2.0
    assert compared.fits is compared.is_complete is fits
    assert bool(compared.kinds) is not fits
    assert ("show a missing effect. The noise may be larger" in compared.words[0]) is fits


def moves_and_rests(seed, held_nm):
    """A pendulum that moves and rests in turn, at each rest with another torque that friction holds."""
    rng, at, moves = np.random.default_rng(seed), np.linspace(0.0, 1.0, 100), 120
    angle = rng.uniform(-1.0, 1.0, moves + 1)
    move = angle[:-1, None] + np.diff(angle)[:, None] * (10 * at**3 - 15 * at**4 + 6 * at**5)
    q = np.hstack([move, np.repeat(move[:, -1:], 50, axis=1)]).ravel()
    held = held_nm * rng.standard_normal((moves, 1)) * (np.arange(150) >= 100)
    time_s, run = 0.01 * np.arange(len(q)), np.arange(len(q)) // (len(q) // 3)
    v = np.gradient(q, time_s)
    a = np.gradient(v, time_s)
    torque = 0.05 * a + 2.0 * np.sin(q) + 0.15 * v + held.ravel() + rng.normal(0.0, 0.02, len(q))
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, q, v, a, torque, run, np.full(len(q), -1))


@pytest.mark.parametrize(("held_nm", "complete"), [(0.0, True), (0.05, True), (0.3, False)])
def test_error_far_above_the_noise_is_not_complete_even_if_no_signal_explains_it(held_nm, complete):
    fit = fit_model(moves_and_rests(1, held_nm), SWING, {})
    judge = Completeness(fit, np.random.default_rng(0))
    assert judge.leaves_noise(fit)
    assert judge.is_complete(fit) is complete
    if not complete:
        assert "times the noise, and no signal of the data explains it" in judge.residual_finding(fit).reason
