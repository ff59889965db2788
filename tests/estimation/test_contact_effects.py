from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from tests.estimation import presses
from tests.estimation.contact_data import base_model, channel
from tests.estimation.presses import NOISE_N, K, kelvin_voigt, maxwell, motion, session
from tests.estimation.searches import PRESS


def around_the_surface(kind=ChannelKind.CONTACT):
    x = np.array([-0.002, -0.001, 0.0, 0.001, 0.004])
    return channel(np.zeros(5), x, np.full(5, 0.1), np.arange(5.0), kind=kind)


def test_contact_pushes_only_while_pressed_and_a_two_sided_spring_pulls():
    data = around_the_surface()
    for name in ("stiffness", "damping", "hunt_crossley"):
        columns = EFFECTS[name]().columns(data, {"n": 1.5})
        assert not columns[:3].any()
        assert (columns[3:] > 0).all()
    data = around_the_surface(ChannelKind.PRISMATIC)
    np.testing.assert_array_equal(EFFECTS["stiffness"]().columns(data, {})[:, 0], data.position)
    np.testing.assert_array_equal(EFFECTS["damping"]().columns(data, {})[:, 0], data.velocity)


def test_offset_moves_the_surface():
    data = around_the_surface()
    deeper = EFFECTS["contact_offset"]().move(data, {"offset": 0.002})
    np.testing.assert_array_equal(deeper.engaged, [False, False, False, False, True])
    np.testing.assert_array_equal(deeper.velocity, data.velocity)
    assert data.position[-1] == 0.004


def test_units_follow_the_channel():
    model = base_model("spring_mass_damper")
    revolute = around_the_surface(ChannelKind.REVOLUTE)
    prismatic = around_the_surface(ChannelKind.PRISMATIC)
    assert dict(zip(model.gains, model.units(prismatic), strict=True))["stiffness.k"] == "N/m"
    assert dict(zip(model.gains, model.units(revolute), strict=True))["damping.c"] == "N m s/rad"


@pytest.mark.parametrize("name", list(MODELS))
def test_every_base_model_has_a_description(name):
    model = MODELS[name]
    assert model.name == name
    assert model.channels <= frozenset(ChannelKind)
    assert model.__doc__


def two_presses():
    """One press, recorded as run 5, and a later, shallower one, that is called run 2."""
    t = np.concatenate([3.0 + np.arange(100) * 0.01, np.arange(100) * 0.01])
    depth = np.concatenate([0.5 * np.sin(np.pi * np.arange(100) / 100), np.sin(np.pi * np.arange(100) / 100)])
    force = 5 * depth + np.random.default_rng(0).normal(0, 0.02, 200)
    return channel(force, depth, np.gradient(depth, 0.01), t, run=np.repeat([2, 5], 100))


def test_dent_persists_to_the_next_press_in_time_until_the_clock_restarts():
    data = two_presses()
    apart = replace(data, time_s=np.tile(data.time_s[100:], 2))
    kept, fresh = (
        each.position - EFFECTS["plastic_set"]().move(each, {"share": 0.1, "kept": 1.0}).position
        for each in (data, apart)
    )
    assert kept[:100] == pytest.approx(np.full(100, 0.1))  # for any run numbers
    assert kept[100] == fresh[0] == fresh[100] == 0.0
    assert fresh[50:100] == pytest.approx(np.full(50, 0.05))


def test_plastic_indentation_separates_or_damps_the_tool():
    """The spring is at rest there in either form; deeper, both are the same but for the growing dent."""
    x = np.array([0.0, 0.5, 1.0, 0.5, 0.2, -0.1])
    v = np.array([1.0, 1.0, 0.0, -1.0, -1.0, -1.0])
    data, inner = channel(np.zeros(6), x, v, np.arange(6.0)), {"share": 0.3, "kept": 0.0}
    sinks, stays = (form.move(data, inner) for form in EFFECTS["plastic_set"]().forms())
    for moved, damped in ((sinks, [0.7, 0.0, -1.0, 0.0]), (stays, [1.0, 0.0, -1.0, -1.0])):
        spring, damper = (EFFECTS[name]().columns(moved, {})[:, 0] for name in ("stiffness", "damping"))
        assert spring == pytest.approx([0.0, 0.35, 0.7, 0.2, 0.0, 0.0])
        assert damper[1:5] == pytest.approx(damped)


def test_hysteresis_of_a_sensor_is_the_same_for_one_or_many_columns():
    data, sensor = two_presses(), EFFECTS["hysteresis"]()
    efforts = np.column_stack([5 * data.position, 3 * data.position - 0.2, np.zeros(200)])
    together = sensor.sense(efforts, data, {"width": 0.3})
    for column, effort in enumerate(efforts.T):
        np.testing.assert_allclose(together[:, column], sensor.sense(effort, data, {"width": 0.3}))


def test_branches_are_ordered_by_time_constant():
    data = session(1)
    branches = Model("kelvin_voigt", (*PRESS.effects, EFFECTS["relaxation_spectrum"]()))
    names = [f"relaxation_spectrum.{name}" for name in ("fast", "slow", "fast_time", "slow_time")]
    crossed = {"stiffness.k": 800.0, "damping.c": 15.0} | dict(zip(names, (0.1, 0.3, 2.0, 0.1), strict=True))
    told = branches.in_order(crossed)
    assert [told[name] for name in names] == [0.3, 0.1, 0.1, 2.0]
    np.testing.assert_allclose(branches.predict(data, told), branches.predict(data, crossed), atol=1e-12)
    assert replace(branches, held={names[2]: 2.0}).in_order(crossed) == crossed


def test_dry_friction_reverses_with_the_position_despite_a_late_velocity():
    t, path_m, gone_back = np.arange(0.0, 2.0, 0.001), 0.0002, 0.00005
    x = np.where(t < 1.0, 0.001 + 0.004 * t, 0.005 - gone_back * np.minimum((t - 1.0) / 0.5, 1.0))
    late = np.where(t < 1.2, 0.004, -gone_back / 0.5)
    data = channel(np.zeros_like(t), x, late, t)
    s = EFFECTS["dry_friction"]().columns(data, {"presliding": path_m, "transition": 1e-6})[:, 0]
    # Dahl's law between two reversals: an exponential of the way gone since.
    assert s[990] == pytest.approx(1.0, abs=1e-3)
    assert s[-1] == pytest.approx(2.0 * np.exp(-gone_back / path_m) - 1.0, abs=0.02)


def springpot(time_s, x, run, alpha):
    """Each change of the depth within a run relaxes as (t / 1 s)^-alpha; steps are linear in time."""
    parts = []
    for number in np.unique(run):
        t, steps = time_s[run == number], np.diff(x[run == number])
        since = np.maximum(t[:, None] - t[None], 0.0) ** (1.0 - alpha) / (1.0 - alpha)
        parts.append((since[:, :-1] - since[:, 1:]) @ (steps / np.diff(t)))
    return np.concatenate(parts)


def branches(time_s, x, run):
    return 0.3 * maxwell(time_s, x, run, 0.1) + 0.2 * maxwell(time_s, x, run, 1.0)


FROM_REST = {  # the hidden force beside a spring and a damper, and the parameters
    "stress_relaxation": (lambda *press: 600.0 * maxwell(*press, 0.3), {"k1": 600.0, "tau": 0.3}),
    "relaxation_spectrum": (
        lambda t, x, run: K * (branches(t, x, run) - 0.5 * x),
        {"fast": 0.3, "slow": 0.2, "fast_time": 0.1, "slow_time": 1.0},
    ),
    "power_law_relaxation": (
        lambda t, x, run: 0.6 * K * (springpot(t, x, run, 0.3) - x),
        {"share": 0.6, "alpha": 0.3},
    ),
}


@pytest.mark.parametrize("name", FROM_REST)
def test_run_that_begins_pressed_may_begin_relaxed(name):
    force, truth = FROM_REST[name]
    rng = np.random.default_rng(3)
    time_s, x, v, run = motion(rng, runs=3)
    x = x + 0.006  # every run begins 2 mm deep
    hidden = kelvin_voigt(x, v, force(time_s, x, run)) + rng.normal(0.0, NOISE_N, len(x))
    data = presses.channel(hidden, time_s, x, v, run)
    base = EFFECTS["stiffness"](), EFFECTS["damping"]()
    starts = {f"{name}.{parameter}": 0.8 * value for parameter, value in truth.items()}
    pressed, rested = (
        fit_model(data, Model("m", (*base, form)), starts) for form in EFFECTS[name]().suited_to(data).forms()
    )
    assert pressed.rmse > 2.0 * NOISE_N
    assert rested.rmse == pytest.approx(NOISE_N, rel=0.03)
    accuracy = 0.02 if name == "stress_relaxation" else 0.1
    for parameter, value in truth.items():
        fitted = rested.solution.parameters[f"{name}.{parameter}"]
        assert fitted == pytest.approx(value, rel=accuracy), parameter


@pytest.mark.parametrize("name", FROM_REST)
def test_run_that_begins_in_air_relaxes_alike_in_both_forms(name):
    truth = FROM_REST[name][1]
    time_s, x, v, run = motion(np.random.default_rng(3), runs=2)
    x = np.where(run == 1, x + 0.006, x)  # only the second run begins pressed
    data = presses.channel(np.zeros(len(x)), time_s, x, v, run)
    forms = EFFECTS[name]().suited_to(data).forms()
    parameters = {"stiffness.k": K, **{f"{name}.{parameter}": value for parameter, value in truth.items()}}
    pressed, relaxed = (
        Model("m", (EFFECTS["stiffness"](), form)).predict(data, parameters) for form in forms
    )
    np.testing.assert_array_equal(pressed[run == 0], relaxed[run == 0])
    assert np.abs(pressed - relaxed)[run == 1].max() > 0.1
    assert [form.form for form in forms] == [form.form for form in forms[1].forms()] == [0, 1]
    air, effect = session(2), EFFECTS[name]()
    first = np.flatnonzero(np.diff(air.run, prepend=-1))
    barely = air.position.copy()
    barely[first] = 0.001 * air.deepest
    assert len(effect.suited_to(air).forms()) == 1
    assert len(effect.suited_to(replace(air, position=barely)).forms()) == 1
