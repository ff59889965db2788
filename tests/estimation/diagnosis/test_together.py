"""Several effects at once: found together, in the order in which the effort passes them."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS
from tests.estimation.presses import NOISE_N, kelvin_voigt, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def named(data, tried=None):
    found = diagnose(data, MODEL, tried, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.MISSING
    assert found.final.rmse == pytest.approx(NOISE_N, rel=0.05)
    return {entry.effect: entry.parameters for entry in found.accepted}


def stuck(force, run, width):
    """A reading that is dragged along by a force with friction between them."""
    reading = np.array(force)
    for i in range(1, len(force)):
        if run[i] == run[i - 1]:
            reading[i] = min(max(reading[i - 1], force[i] - width), force[i] + width)
    return reading


def stiffening(x):
    return 2e6 * np.maximum(x, 0) ** 3


def test_a_curve_that_a_sensor_cuts_off_is_found_though_it_looks_straight():
    # what stiffens below the limit hides what is cut off above: neither alone is of much use
    found = named(session(31, lambda t, x, v, run: np.minimum(kelvin_voigt(x, v, 0.6 * stiffening(x)), 8.5)))
    assert set(found) == {"cubic_stiffness", "saturation"}
    assert found["saturation"]["limit"].value == pytest.approx(8.5, rel=0.01)


def test_friction_ahead_of_the_end_of_the_range_is_no_friction_behind_it():
    found = named(session(32, lambda t, x, v, run: np.minimum(stuck(kelvin_voigt(x, v), run, 0.6), 7.0)))
    assert set(found) == {"hysteresis", "saturation"}
    assert found["hysteresis"]["width"].value == pytest.approx(0.6, rel=0.03)


def test_a_bias_that_friction_holds_back_is_found_beside_it():
    found = named(session(33, lambda t, x, v, run: stuck(kelvin_voigt(x, v) - 0.4, run, 0.5)))
    assert set(found) == {"bias", "hysteresis"}
    assert found["bias"]["offset"].value == pytest.approx(-0.4, abs=0.02)


def test_a_zero_that_drifts_is_seen_in_runs_that_come_later_than_all_others():
    found = named(session(34, lambda t, x, v, run: kelvin_voigt(x, v, stiffening(x)) + 0.05 * t))
    assert set(found) == {"cubic_stiffness", "drift"}


def test_two_curves_that_look_alike_are_found_beside_each_other():
    # a surface that lies deeper looks like stiffening, and more stiffening beside it does not help much
    found = named(session(37, lambda t, x, v, run: kelvin_voigt(x - 0.003, v, stiffening(x - 0.003))))
    assert set(found) == {"cubic_stiffness", "contact_offset"}
    assert found["contact_offset"]["offset"].value == pytest.approx(0.003, rel=0.02)


def test_a_power_law_does_not_swallow_a_surface_that_lies_deeper():
    # with a spring and a damper that pull, its exponent draws both, but for 0.3 % of what they explain
    def deeper(t, x, v, run):
        d = np.maximum(x - 0.004, 0.0)
        return np.maximum(5000.0 * d**1.42 + 17500.0 * d**1.42 * v, 0.0)

    names = ("hunt_crossley", "contact_offset", "cubic_stiffness")
    found = named(session(40, deeper), [EFFECTS[name]() for name in names])
    assert set(found) == {"hunt_crossley", "contact_offset"}
    assert found["contact_offset"]["offset"].value == pytest.approx(0.004, rel=0.03)


def test_what_draws_the_same_once_all_is_fitted_is_stated_though_it_looked_worse_beside_the_rest_as_it_was():
    # below a limit of the reading, a dead band and a surface that lies deeper are one curve
    def short(t, x, v, run):
        return np.clip(np.maximum(1000.0 * x + 4.0 * v, 0.0) * (x > 0) - 3.0, 0.0, 4.5)

    tried = [EFFECTS[name]() for name in ("deadband", "contact_offset", "saturation")]
    found = diagnose(session(41, short), MODEL, tried, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.MISSING
    groups = [{entry.effect, *entry.confused_with} for entry in found.accepted]
    assert groups == [{"saturation"}, {"deadband", "contact_offset"}]


def test_where_the_edges_of_coarse_steps_lie_tells_a_bias_and_the_stiffness_to_a_fraction_of_a_step():
    # most of a press is held on one tread, which says nothing
    smooth = session(42, lambda t, x, v, run: kelvin_voigt(x, v) + 0.7)
    coarse = replace(smooth, effort=2.0 * np.round(smooth.effort / 2.0))
    tried = [EFFECTS[name]() for name in ("quantisation", "bias", "layered_stiffness")]
    found = diagnose(coarse, MODEL, tried, rng=np.random.default_rng(1)).channels[0]
    assert {entry.effect for entry in found.accepted} == {"quantisation", "bias"}
    fitted = found.final.parameters
    assert fitted["bias.offset"].value == pytest.approx(0.7, abs=0.05)
    assert fitted["stiffness.k"].value == pytest.approx(800.0, rel=0.01)
    assert fitted["quantisation.noise"].value == pytest.approx(NOISE_N, rel=0.4)


def swing(law, runs=5, step=0.01):
    """A joint that swings a pendulum, with `law(angle, velocity)` and noise on top."""
    rng = np.random.default_rng(36)
    t = np.arange(0.0, 8.0, step)
    ways = [np.sin(w * t + p) + 0.4 * np.sin(2.7 * w * t) for w, p in rng.uniform(1.0, 3.0, (runs, 2))]
    q = np.array(ways)
    v = np.gradient(q, step, axis=1)
    a = np.gradient(v, step, axis=1)
    torque = 0.05 * a + 2.0 * np.sin(q) + 0.15 * v + law(q, v) + rng.normal(0.0, 0.02, q.shape)
    run = np.repeat(np.arange(runs), len(t))
    time_s, unknown = np.tile(t, runs) + 20.0 * run, np.full(run.size, -1)
    motion = (signal.ravel() for signal in (q, v, a))
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, *motion, torque.ravel(), run, unknown)


def named_in_a_joint(data, names):
    tried = [EFFECTS[name]() for name in names]
    model = MODELS["pendulum"]().build(ModelContext())
    found = diagnose(data, model, tried, rng=np.random.default_rng(1)).channels[0]
    return {entry.effect for entry in found.accepted}


def test_the_step_of_a_damper_at_a_surface_that_lies_deeper_is_no_misfit():
    # where the contact begins is known only with the offset: a block across it holds half of the step
    found = named(session(39, lambda t, x, v, run: stuck(kelvin_voigt(x - 0.002, v), run, 0.6)))
    assert set(found) == {"contact_offset", "hysteresis"}


def test_friction_beside_a_bias_is_not_called_uneven():
    # a bias and an even friction draw the levels of an uneven one, with two parameters less
    joint = swing(lambda q, v: 0.3 * np.tanh(v / 0.01) + 0.1)
    names = ("coulomb_friction", "asymmetric_friction", "bias", "joint_spring")
    assert named_in_a_joint(joint, names) == {"coulomb_friction", "bias"}


def test_a_spring_is_no_cubic_one_though_it_has_a_rest_to_be_found():
    # beside a weight, what a straight spring adds is nearly a cubic curve
    joint = swing(lambda q, v: 0.4 * q)
    assert named_in_a_joint(joint, ("joint_spring", "cubic_stiffness", "bias")) == {"joint_spring"}


@pytest.mark.parametrize(
    ("name", "inner"),
    [("saturation", {"limit": 6.0}), ("deadband", {"width": 1.0}), ("hysteresis", {"width": 0.5})],
)
def test_slopes_of_bent_readings_are_their_differences(name, inner):
    data = session(35)
    columns = np.column_stack([np.maximum(data.position, 0.0), data.velocity * data.engaged])
    effort, sensor = columns @ [800.0, 15.0], EFFECTS[name]()
    slopes = sensor.slope(effort, columns, data, inner)
    for column, slope in zip(columns.T, slopes.T, strict=True):
        ahead = sensor.sense(effort + 1e-7 * column, data, inner)
        difference = (ahead - sensor.sense(effort, data, inner)) / 1e-7
        assert np.mean(np.abs(slope - difference)) < 1e-4 * np.mean(np.abs(difference))
