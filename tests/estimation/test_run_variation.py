"""Run variation: a run's first part estimates its own value; equal runs have none."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.diagnosis.diagnose import diagnose_channel
from palpate.estimation.diagnosis.result import Verdict
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.fit.measurement_noise import run_heterogeneity
from palpate.estimation.model import Model
from tests.estimation.contact_data import base_model
from tests.estimation.contact_data import channel as pressed
from tests.estimation.recover import channel, recover
from tests.estimation.test_effects_recover import REVOLUTE, runs
from tests.few_effects import shorten_budget

NOISE = 0.05
TRIED = ("run_gain", "run_offset", "cubic_stiffness", "layered_stiffness", "bias", "contact_offset")


def presses(offsets, gains, seed=0, count=400):
    """A spring of 4 N m/rad in runs with zeros and gains of their own."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) * 5e-3
    parts = []
    for offset, gain in zip(offsets, gains, strict=True):
        q = np.sin(3.0 * t + rng.uniform(0, 6))
        parts.append((t, q, 4.0 * gain * q + offset + NOISE * rng.standard_normal(len(t))))
    (t, q, torque), run = runs(parts)
    return channel(REVOLUTE, t, q, torque, run=run)


def rest_of_runs(data, effect, predicted):
    return float(np.sqrt(np.mean((data.effort - predicted)[~effect.first_part(data)] ** 2)))


@pytest.mark.parametrize(("name", "spread"), [("run_offset", 0.8), ("run_gain", 0.2)])
def test_unseen_run_estimates_its_own_value(name, spread):
    own = spread * np.random.default_rng(1).standard_normal(40)
    offsets, gains = (own, np.ones(40)) if name == "run_offset" else (np.zeros(40), 1.0 + own)
    data, effect = presses(offsets, gains), EFFECTS[name]()
    seen, unseen = data.of_runs(np.arange(30)), data.of_runs(np.arange(30, 40))
    found, _ = recover(seen, ("stiffness",), name)
    model = Model("m", (EFFECTS["stiffness"](), effect))
    assert rest_of_runs(unseen, effect, model.predict(unseen, found)) == pytest.approx(NOISE, rel=0.15)
    plain = found["stiffness.k"] * seen.position
    inner = {"share": found[f"{name}.share"]}
    (told,) = effect.spread(plain, seen, inner)
    assert told == pytest.approx(np.std(own[:30]), rel=0.15)
    whole = effect.values(plain, seen, inner, rows=np.ones(len(seen), dtype=np.bool_))
    assert np.corrcoef(whole[:, 0], own[:30])[0, 1] > 0.995


@pytest.mark.parametrize("spread", [0.3, 0.0])
def test_many_short_runs_show_whether_they_follow_one_law(spread):
    gains = 1.0 + spread * np.random.default_rng(1).standard_normal(60)
    run, depth = np.repeat(np.arange(60), 9), np.tile(np.linspace(0.001, 0.009, 9), 60)
    force = 500.0 * gains[run] * depth + NOISE * np.random.default_rng(2).standard_normal(len(run))
    data = pressed(force, depth, np.full(len(run), 0.001), np.arange(len(run)) + 10.0 * run, run=run)
    end = fit_model(data, base_model("kelvin_voigt"), {})
    found = run_heterogeneity(end.problem.blocked, end.solution)
    assert (found is not None) is (spread > 0.0)
    assert found is None or found.alone == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize("start", [2.0, 9.0])
@pytest.mark.parametrize("share", [0.99, 1.0])
def test_model_describes_the_mean_run_if_runs_have_gains_of_their_own(start, share):
    gains = np.array([0.8, 1.0, 1.8])
    data, model = presses(np.zeros(3), gains), Model("m", (EFFECTS["stiffness"](), EFFECTS["run_gain"]()))
    parameters = {"stiffness.k": start, "run_gain.share": share}
    problem = fit_model(data, model, parameters).problem
    for _ in range(20):
        solution = solve_gains(problem, model, parameters)
        parameters = solution.parameters
    assert parameters["stiffness.k"] == pytest.approx(4.0 * gains.mean(), rel=0.02)
    _, effort = model.linearize(data, parameters)
    assert effort == pytest.approx(model.predict(data, parameters), abs=0.02)


def test_run_without_effort_does_not_change_the_model():
    data = presses(np.zeros(4), np.array([0.8, 1.0, 1.8, 1e-3]))
    data = replace(data, position=np.where(data.run == 3, 1e-3, 1.0) * data.position)
    model = Model("m", (EFFECTS["stiffness"](), EFFECTS["run_gain"]()))
    fit = fit_model(data, model, {"stiffness.k": 2.0, "run_gain.share": 1.0})
    assert fit.solution.parameters["stiffness.k"] == pytest.approx(4.8, rel=0.02)


def test_gains_of_runs_are_not_centered_if_the_model_cannot_scale_its_effort():
    gains = np.array([0.75, 0.8, 0.85])
    data, effect = presses(np.zeros(3), gains), EFFECTS["run_gain"]()
    known, inner = 4.0 * data.position, {"share": 1.0}
    _, effort = effect.follow(known, np.empty((len(data), 0)), data, inner)
    assert effort == pytest.approx(effect.sense(known, data, inner))


@pytest.mark.parametrize("name", ["run_offset", "run_gain"])
def test_equal_runs_have_no_values_of_their_own(name):
    data, effect = presses(np.zeros(30), np.ones(30)), EFFECTS[name]()
    errors = {}
    for share in (0.0, 0.3, 1.0):
        model = Model("m", (EFFECTS["stiffness"](), effect))
        predicted = model.predict(data, {"stiffness.k": 4.0, f"{name}.share": share})
        errors[share] = rest_of_runs(data, effect, predicted)
    assert errors[0.0] <= errors[0.3] <= errors[1.0]


@pytest.mark.parametrize("name", ["run_offset", "run_gain", "run_ripple"])
def test_values_of_a_run_are_independent_of_other_runs_and_its_end(name):
    data, effect = presses(0.5 * np.arange(4), np.ones(4)), EFFECTS[name]()
    inner = {"share": 0.7} | ({"cycles": 5.0} if name == "run_ripple" else {})
    effort = 4.0 * data.position
    together = effect.values(effort, data, inner)
    for number in range(4):
        rows = data.run == number
        np.testing.assert_allclose(effect.values(effort[rows], data.select(rows), inner)[0], together[number])
    if name == "run_gain":
        return  # its first part ends by a share of the whole effort
    late = np.where(effect.first_part(data), data.effort, 99.0)
    changed = type(data)(**{**vars(data), "effort": late})
    np.testing.assert_allclose(effect.values(effort, changed, inner), together)


@pytest.mark.parametrize(("common", "told"), [(0.0, False), (0.8, False), (4.0, True)])
def test_common_part_of_runs_is_no_run_variation(common, told):
    own = np.random.default_rng(4).standard_normal(12)
    data, effect = presses(common + 0.5 * (own - own.mean()), np.ones(12)), EFFECTS["run_offset"]()
    assert effect.is_common(4.0 * data.position, data, {"share": 1.0}) is told


@pytest.mark.parametrize(
    ("gain", "gradual"),
    [
        (lambda run, share: 0.1 * (run % 2), False),
        (lambda run, share: 0.05 * (run + share), True),  # goes on from run to run
        (lambda run, share: 0.02 * (run % 2) + 0.2 * share, True),  # each run alike
    ],
)
def test_change_within_runs_is_no_run_variation(gain, gradual):
    count, number = 400, 6
    share, run = np.tile(np.linspace(0.0, 1.0, count), number), np.repeat(np.arange(number), count)
    q = np.sin(40.0 * share + run)
    torque = 4.0 * q
    data = channel(REVOLUTE, 2.0 * share, q, torque * (1.0 + gain(run, share)), run=run)
    assert EFFECTS["run_gain"]().is_gradual(torque, data, {"share": 1.0}) is gradual


def test_interval_of_a_stiffness_covers_the_mean_of_all_specimens():
    """Six specimens of 4 N m/rad, whose stiffnesses differ by 10 %: Student's interval of their mean."""
    model = Model("m", (EFFECTS["stiffness"](), EFFECTS["viscous_friction"](), EFFECTS["run_gain"]()))
    covered, halves = 0, []
    for seed in range(20):
        gains = 1.0 + 0.1 * np.random.default_rng(seed).standard_normal(6)
        data = presses(np.zeros(6), gains, seed, count=200)
        found = fit_model(data, model, {"run_gain.share": 0.95}).parameters["stiffness.k"]
        covered += found.interval[0] <= 4.0 <= found.interval[1]
        halves.append(0.5 * np.ptp(found.interval))
    assert covered >= 17  # 98.4 % of draws if the interval covers in 95 %
    assert np.mean(halves) == pytest.approx(2.57 * 0.4 / np.sqrt(6.0), rel=0.2)


@pytest.mark.parametrize("count", [3, 6])
def test_zeros_of_runs_leave_a_stiffness_as_certain_as_before(count):
    """What each run determines by itself hardly depends on how much the zeros differ."""
    zeros = np.random.default_rng(2).standard_normal(count)
    model = Model("m", (EFFECTS["stiffness"](), EFFECTS["run_offset"]()))
    data = presses(zeros, np.ones(count))
    found = fit_model(data, model, {"run_offset.share": 0.95}).parameters["stiffness.k"]
    alone = fit_model(presses(np.zeros(count), np.ones(count)), Model("m", (EFFECTS["stiffness"](),)), {})
    assert np.ptp(found.interval) < 1.3 * np.ptp(alone.parameters["stiffness.k"].interval)


@pytest.mark.parametrize("differ", [True, False])
def test_short_pulls_show_gains_of_specimens_only_if_they_differ(differ, monkeypatch):
    """Pulls of 60 readings; each specimen has its own gain and a wave that no law has."""
    rng = np.random.default_rng(5)
    gains = np.linspace(0.5, 1.5, 3) if differ else np.ones(3)
    shorten_budget(monkeypatch)
    time_s = np.linspace(0.0, 6.0, 60)
    parts = []
    for gain in rng.permutation(gains):
        stretch_m = 1e-3 * time_s
        wave = 0.4 * np.sin(rng.uniform(3.0, 5.0) * time_s) * stretch_m / stretch_m[-1]
        parts.append((time_s, stretch_m, 2e3 * gain * stretch_m + wave + 0.02 * rng.standard_normal(60)))
    (time_s, stretch_m, force_n), run = runs(parts)
    data = pressed(force_n, stretch_m, np.full(len(run), 1e-3), time_s, run=run)
    model = base_model("kelvin_voigt")
    effects = [EFFECTS[name]() for name in TRIED]
    result = diagnose_channel(data, model, effects, np.random.default_rng(0))
    if not differ:
        assert "run_gain" not in [entry.effect for entry in result.accepted]
        return
    assert result.verdict is Verdict.MISSING
    assert result.accepted[0].effect == "run_gain"
    assert result.final.rmse < 0.4 * result.baseline.rmse
