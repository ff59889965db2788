"""Memory of an object between runs: whether and how fast it recovers."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.data.file_columns import FileColumns
from palpate.estimation.data.import_file import import_table
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import table_of
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.time_memory import RelaxationSpectrum
from palpate.estimation.models import MODELS
from palpate.estimation.signals.blocks import since_start
from palpate.estimation.signals.contact_memory import (
    above_free_surface,
    free_surface_memory,
    remaining_strain,
)
from palpate.estimation.signals.exponential_memory import relax
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.fitting import fit_base, recovery
from tests.estimation.presses import (
    NOISE_N,
    RATE_HZ,
    K,
    channel,
    kelvin_voigt,
    long_session,
    maxwell,
    session,
)

TAU_S = 1.5


def remembered(time_s, x, tau_s):
    """The same spring and dashpot, never let go: what has not flowed back between two runs is still there."""
    z, before_m = np.zeros_like(x), 0.0
    pressed = np.maximum(x, 0.0)
    left = 0.0
    for i in range(len(x)):
        step_s = time_s[i] - time_s[i - 1] if i else 1.0 / RATE_HZ
        left = (left * np.exp(-(step_s - 1.0 / RATE_HZ) / tau_s) + pressed[i] - before_m) / (
            1.0 + 1.0 / RATE_HZ / tau_s
        )
        z[i], before_m = left, pressed[i]
    return z


@pytest.mark.parametrize("cubic_n_m3", [0.0, 1e7])
@pytest.mark.parametrize("afresh", [True, False])
def test_data_decide_whether_the_object_remembered(afresh, cubic_n_m3):
    def law(t, x, v, run):
        relaxing = 500.0 * (maxwell(t, x, run, TAU_S) if afresh else remembered(t, x, TAU_S))
        return kelvin_voigt(x, v, relaxing + cubic_n_m3 * x**3)

    data = session(61, law)
    assert recovery(data) == (afresh, 1.0, 0.0)
    assert recovery(replace(data, time_s=since_start(data.time_s, data.run))) == (False, 1.0, 0.0)
    study = ModelStudy(data)
    values = study.fit("contact", ["cubic_stiffness", "stress_relaxation"]).values
    assert values["stress_relaxation.tau"] == pytest.approx(TAU_S, rel=0.1)
    assert ("to have recovered when each run begins" in " ".join(study.notes)) == afresh


def test_fresh_runs_keep_spread_times_and_need_relaxation():
    t = np.arange(400) * 0.01
    x, f = 0.004 * (1.0 - np.cos(3.0 * t)), 2.0 * (1.0 - np.cos(3.0 * t))
    coarse_s = 5.0 + 0.02 * np.repeat(np.arange(200), 2)  # a clock that advances with every second row
    columns = FileColumns(pa.table({"time_s": coarse_s, "displacement_m": x, "force_N": f}))
    (channel,) = import_table(table_of(columns, Path("press")), ImportOptions(fresh=True, runs=1)).channels
    assert channel.time_s == pytest.approx(t, abs=1e-6)
    assert recovery(session(62)) == (False, 1.0, 0.0)


def damped_surface(time_s, x, v, run, *, cubic=0.0, afresh=False):
    """Force K (x + cubic x^3 + v) of an object whose surface is free where the tip does not hold it."""
    depth_m, force = 0.0, np.zeros(len(x))
    for i in range(1, len(x)):
        if afresh and run[i] != run[i - 1]:
            depth_m = 0.0
        elif depth_m > 0.0:
            depth_m = ((depth_m**-2 + cubic) * np.exp(2.0 * (time_s[i] - time_s[i - 1])) - cubic) ** -0.5
        if x[i] >= depth_m:
            depth_m, force[i] = x[i], max(K * (x[i] + cubic * x[i] ** 3 + v[i]), 0.0)
    return force


@pytest.mark.parametrize("afresh", [True, False])
def test_nothing_is_missing_where_a_damped_surface_has_not_recovered(afresh):
    study = ModelStudy(session(64, partial(damped_surface, afresh=afresh)))
    (found,) = study.diagnose().channels
    assert (found.verdict, found.recovers) == ("adequate", False)
    assert study.fit("contact", []).values == pytest.approx({"stiffness.k": K, "damping.c": K}, rel=2e-3)
    assert any("damped surface is assumed to recover" in note for note in study.notes) is not afresh


def test_law_whose_surface_recovers_at_once_needs_no_recovery():
    """Many simulators compute max(0, k x + c v)."""
    study = ModelStudy(session(64, lambda t, x, v, run: np.maximum(K * (x + v), 0.0) * (x > 0.0)))
    assert not study.channels[0].data.surface_recovers
    assert study.fit("contact", []).rmse < 1.1 * NOISE_N


def test_samples_at_the_touch_of_a_recovering_surface_are_excluded():
    """The force jumps by up to 80 N there, and an error of the position shifts the touch."""
    data = replace(long_session(64, damped_surface), surface_recovers=True)
    error = np.random.default_rng(5).normal(0.0, 3e-5, len(data))
    model = MODELS["kelvin_voigt"]().build(ModelContext())
    assert fit_base(replace(data, position=data.position + error), model).rmse < 1.1 * NOISE_N


def test_damped_surface_recovers_to_the_surface_of_the_model():
    data = replace(session(64, damped_surface), surface_recovers=True)
    model = MODELS["kelvin_voigt"]().build(ModelContext())
    moved_model = model.with_effect(EFFECTS["contact_offset"]())
    moved = replace(data, position=data.position - 2.0**-9)  # exact in binary
    values = {"stiffness.k": K, "damping.c": K, "contact_offset.offset": -(2.0**-9)}
    found, same = (
        each.recovering(channel_data, values, each.parts(channel_data, values))
        for each, channel_data in ((moved_model, moved), (model, data))
    )
    assert same.any()
    assert np.mean(found != same) < 1e-3


def test_damped_surface_recovers_by_the_elastic_law_of_the_object():
    study = ModelStudy(session(64, partial(damped_surface, cubic=1e4)))
    truth = {"stiffness.k": K, "damping.c": K, "cubic_stiffness.k3": 1e4 * K}
    assert study.fit("contact", ["cubic_stiffness"]).values == pytest.approx(truth, rel=5e-3)


@pytest.mark.parametrize(
    ("elastic_n", "free_m"),
    [
        (lambda x: 800.0 * np.maximum(x, 0.0) ** 2, lambda t: 1.0 / (100.0 + 80.0 * t)),
        (lambda x: 10.0 * np.maximum(x - 0.001, 0.0), lambda t: 0.001 + 0.009 * np.exp(-t)),
    ],
    ids=["quadratic", "beginning at 1 mm"],
)
@pytest.mark.parametrize("change", [{}, {"recovers": True}, {"time_s": np.tile(np.arange(1000.0), 2) * 1e-3}])
def test_tip_touches_a_surface_that_recovers_by_its_law(elastic_n, free_m, change):
    """It is held at 10 mm, leaves, and presses again after 0.9 s."""
    x = np.concatenate([np.full(100, 0.01), [0.009], np.full(899, -0.001), np.linspace(0.0, 0.01, 1000)])
    time_s, v, run = np.arange(2000) * 1e-3, 1e3 * np.diff(x, prepend=x[0]), np.repeat([0, 1], 1000)
    pushing_n = np.where(x > 0.0, elastic_n(x) + 10.0 * v, 0.0)
    data = replace(channel(pushing_n, time_s, x, v, run), **change)
    left, pressed = pushing_n < 0.0, elastic_n(x) > 0.0
    recovering = pressed & (run == 1) & (x < free_m(time_s - 0.099)) & (not change)
    found = above_free_surface(pushing_n, elastic_n(x), 10.0, data)
    np.testing.assert_array_equal(found, left | recovering)


def free_surface(time_s, x, v, run, *, k, branches):
    """Force of a generalized Maxwell solid whose surface is free where the tip does not hold it."""
    clock_s = np.arange(time_s[0], time_s[-1], 4e-4)
    stiffness, tau_s = np.array(branches).T
    depth_m, z = 0.0, np.zeros(len(branches))
    force = np.zeros(len(clock_s))
    for i, tip_m in enumerate(np.interp(clock_s, time_s, x)):
        z *= np.exp(-4e-4 / tau_s)
        free_m = (stiffness.sum() * depth_m - stiffness @ z) / (k + stiffness.sum())
        z += max(tip_m, free_m) - depth_m
        depth_m = max(tip_m, free_m)
        force[i] = k * depth_m + stiffness @ z
    return np.interp(time_s, clock_s, force)


@pytest.mark.parametrize(
    ("effect", "branches", "truth"),
    [
        (
            "stress_relaxation",
            [(500.0, 1.0)],
            {"stiffness.k": 400.0, "stress_relaxation.k1": 500.0, "stress_relaxation.tau": 1.0},
        ),
        (
            "relaxation_spectrum",
            [(200.0, 0.1), (300.0, 1.5)],
            {
                "stiffness.k": 900.0,
                "relaxation_spectrum.slow": 1 / 3,
                "relaxation_spectrum.fast_time": 0.1,
                "relaxation_spectrum.slow_time": 1.5,
            },
        ),
    ],
)
def test_relaxation_is_estimated_although_the_free_surface_has_not_recovered(effect, branches, truth):
    """With zero strain in free air, the time constants are 30 to 60 % too long."""
    study = ModelStudy(session(63, partial(free_surface, k=400.0, branches=branches)))
    values = study.fit("contact", [effect]).values
    assert {name: values[name] for name in truth} == pytest.approx(truth, rel=0.02)
    assert "surface moves freely" in " ".join(study.notes)


@pytest.mark.parametrize("k", [50.0, 100.0])
def test_recovery_of_an_object_with_little_lasting_stiffness(k):
    """With a held surface, relaxation of the first does not lower the held-out error enough."""
    data = session(63, partial(free_surface, k=k, branches=[(500.0, 1.0)]))
    assert recovery(data)[:2] == (False, pytest.approx(k / (k + 500.0), rel=0.015))


@pytest.mark.usefixtures("whole_budget")
def test_recovery_of_an_object_without_linear_stiffness():
    """Two branches bear 80 % of a force that grows with the cube of the depth."""
    law = partial(free_surface, k=2e6, branches=[(4e6, 0.1), (4e6, 1.5)])
    data = session(63, lambda t, x, v, run: law(t, x**3, v, run))
    assert recovery(data) == (False, pytest.approx(0.2, rel=0.01), pytest.approx(0.0, abs=1e-3))


RATES, SHARES = np.array([5.0, 0.5]), np.array([0.4, 0.3])


@pytest.mark.parametrize(
    "memory",
    [
        lambda strain, data: free_surface_memory(strain, data, RATES, SHARES),
        lambda strain, data: free_surface_memory(strain, replace(data, retardation_s=0.3), RATES, SHARES),
        lambda strain, data: remaining_strain(
            partial(relax, tau_s=1.0), strain, data.time_s, data.run, data, data.engaged
        ),
    ],
)
def test_memory_of_a_free_surface_depends_on_times_and_not_on_the_order_of_runs(memory):
    data = session(61)
    data = replace(data.select(data.engaged), recovery_ratio=0.4)
    strain, order = data.position[:, None], np.argsort(-data.run, kind="stable")
    assert memory(strain[order], data.select(order)) == pytest.approx(memory(strain, data)[order])
    separate = replace(data, time_s=since_start(data.time_s, data.run))
    last = data.run == data.runs[-1]
    assert memory(strain, separate)[last] == pytest.approx(memory(strain[last], data.select(last)))


def test_an_unstable_free_surface_does_not_overflow_in_a_long_pause():
    data = replace(session(61), recovery_ratio=0.4)
    data = replace(data, time_s=data.time_s + 1e5 * data.run)
    memory = free_surface_memory(np.maximum(data.position, 0.0)[:, None], data, RATES, 2.0 * SHARES)
    assert np.all(np.abs(memory) < 10.0 * data.deepest)


def test_runs_that_begin_relaxed_keep_their_form_with_a_free_surface():
    data = session(61)
    data = replace(data.select(data.position > 0.6 * data.deepest), recovery_ratio=0.4)
    _, relaxed = RelaxationSpectrum().suited_to(data).forms()
    inner = dict(zip(("fast", "slow"), SHARES, strict=True)) | {"fast_time": 0.2, "slow_time": 2.0}
    held = np.ones((len(data), 1))
    assert relaxed.fade(held, data, inner) == pytest.approx(held * (1.0 - SHARES.sum()))
