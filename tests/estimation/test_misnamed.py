"""Parameters within their bounds that contradict the name of their effect."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.diagnosis import candidates
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.elastic_shape import Stiffness
from palpate.estimation.effects.inertia import Inertia
from palpate.estimation.effects.path_memory import Backlash
from palpate.estimation.effects.sensor_statics import Saturation
from palpate.estimation.fit.fit_problem import solve_gains
from palpate.estimation.fit.fit_result import fit_model
from palpate.estimation.model import Model
from tests.estimation.presses import channel, colored_noise, session
from tests.estimation.test_effect_form import some_channel

NOISE_N = 0.05
PRESS = session(1, runs=4)
JOINT = some_channel(ChannelKind.REVOLUTE)
NAN = float("nan")


def spring(offset_n=0.0):
    return session(1, lambda t, x, v, run: 800.0 * x.clip(0.0) + offset_n)


def is_misnamed(name, data, own, noise=NOISE_N, more=None, errors=dict):
    given = {f"{name}.{parameter}": value for parameter, value in own.items()} | (more or {})
    return EFFECTS[name]().is_misnamed(data, given, errors, noise)


@pytest.mark.parametrize(
    ("k", "k2", "error", "more", "layer"),
    [
        *((k, k2, 0.0, {}, True) for k, k2 in ((800.0, 700.0), (800.0, -500.0), (40.0, 2e4), (1500.0, 30.0))),
        *((k, 1500.0, 0.0, {}, False) for k in (-9000.0, 0.0, 5.0)),  # nothing above the kink: a gap
        *((1500.0, k2, 0.0, {}, False) for k2 in (-1500.0, -1498.0, -3000.0)),  # the end of a range
        *((823.0, -762.0, error, {}, layer) for error, layer in ((20.0, True), (140.0, False), (NAN, True))),
        (40.0, 2e4, 100.0, {}, True),  # less stiff than the other is uncertain
        (0.0, 1500.0, 0.0, {"cubic_stiffness.k3": 5e7}, True),  # which presses back too
        (800.0, -500.0, 0.0, {"cubic_stiffness.k3": -1.5e6}, False),  # it counts below the kink, too
        (0.0, 1500.0, 0.0, {"hunt_crossley.k": 4000.0}, True),  # which may carry the load
        (800.0, 700.0, 0.0, {"layered_stiffness.depth": 0.05}, False),  # deeper than any press
        # At its end the upper layer presses with 3.2 N; if the sensor hides that, it is a deeper surface.
        *(
            (800.0, -500.0, 0.0, {"deadband.width": w}, is_seen)
            for w, is_seen in ((2.5, True), (3.15, False))
        ),
    ],
)
def test_layer_presses_back_above_and_below_its_kink(k, k2, error, more, layer):
    given = {"stiffness.k": k} | more
    found = is_misnamed(
        *("layered_stiffness", PRESS, {"k2": k2, "depth": 0.004}),
        more=given,
        errors=lambda: {"stiffness.k": 1.0, "layered_stiffness.k2": error},
    )
    assert found is not layer


@pytest.mark.parametrize(
    ("name", "data", "names", "cases"),
    [
        (
            *("stribeck_friction", JOINT, ("coulomb", "rise", "speed", "transition")),
            {
                # Friction rises towards rest, or nowhere.
                **dict.fromkeys(
                    ((0.34, 0.2, 0.2, 0.003), (0.34, 0.05, 0.1, 0.003), (0.34, 0.6, 0.03, 0.003)), True
                ),
                **dict.fromkeys(((0.34, 0.19, 0.0076, 0.006), (0.34, 0.19, 0.001, 0.006)), False),
                (0.34, -0.2, 0.2, 0.006): False,
            },
        ),
        # The error of one joint is not that of a force that the other joints carry.
        ("force_sensor_error", JOINT, ("share",), {(1.0,): True, (0.6,): True, (0.5,): False, (1.5,): False}),
        # Friction that drives the motion at some positions is none.
        (
            *("position_dependent_friction", JOINT, ("level", "sine", "cosine", "cycles", "transition")),
            {
                (1.0, 0.5, 0.7, 600.0, 0.01): True,
                (0.2, 0.0, 0.21, 600.0, 0.01): True,  # hardly
                (0.2, -0.6, 0.6, 600.0, 0.01): False,
            },
        ),
        # A damper that grows with depth beside a spring that hardly bends is not Hunt and Crossley's.
        (
            *("hunt_crossley", session(1), ("k", "b", "n")),
            {(5e4, 1e4, 1.5): True, (0.0, 1e6, 2.0): False, (800.0, 500.0, 1.0): True, (2e5, 0.0, 2.0): True},
        ),
        # Readings in free air have the offset.
        ("bias", spring(0.8), ("offset",), {(0.8,): True, (0.6,): True, (2.0,): False, (-0.8,): False}),
        # All readings stay within a gap that is too wide.
        ("hysteresis", session(1), ("width",), {(0.5,): True, (50.0,): False}),
        # Samples are needed in the bend.
        ("softening_stiffness", PRESS, ("a", "d"), {(1.0, 1e-6): False, (1.0, 2e-3): True}),
        # Less than nothing is no load.
        ("payload", JOINT, ("mass",), {(0.4,): True, (-0.1,): False}),
        # Less than half of a run of half a second, and a lead of less than a sample.
        (
            *("delay", JOINT, ("time",)),
            {(-0.0015,): False, (-0.0005,): True, (0.03,): True, (0.24,): True, (0.26,): False},
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_parameters_agree_with_the_name(name, data, names, cases):
    for values, agrees in cases.items():
        assert is_misnamed(name, data, dict(zip(names, values, strict=True))) is not agrees, values


@pytest.mark.parametrize("noise_n", [0.01, 0.1])
@pytest.mark.parametrize(("hidden_n", "shown"), [(0.5, True), (0.0, False)])
def test_dead_band_is_misnamed_if_readings_do_not_stay_at_zero(hidden_n, shown, noise_n):
    data = spring()
    noise = np.random.default_rng(5).standard_normal(len(data))
    hidden = replace(data, effort=np.maximum(data.effort - hidden_n, 0.0) + noise_n * noise)
    assert is_misnamed("deadband", hidden, {"width": 0.5}, 1.0) is not shown
    loud = replace(data, effort=data.effort + 0.2 * noise)  # below the noise, readings show nothing
    assert not is_misnamed("deadband", loud, {"width": 0.5}, 1.0)


@pytest.mark.parametrize(("load", "is_bias"), [(0.0, False), (20.0, True), (-20.0, True)])
def test_dead_band_far_from_all_readings_is_a_bias(load, is_bias):
    effort = load + 6.0 * np.sin(np.linspace(0.0, 20.0, len(JOINT)))
    reading = effort - np.clip(effort, -2.0, 2.0)
    assert is_misnamed("deadband", replace(JOINT, effort=reading), {"width": 2.0}, 0.01) is is_bias


@pytest.mark.parametrize(("steps", "is_tested"), [(2.0, False), (20.0, True)])
def test_rounding_needs_more_changes_of_the_reading_than_parameters(steps, is_tested):
    """Four steps of a motor's voltage look like the rounding of any law that grows with time."""
    effort = np.round(steps * np.sin(np.linspace(0.0, 3.0, len(JOINT))))
    own, others = {"step": 1.0, "noise": 0.1}, {f"viscous_friction.{name}": 1.0 for name in "abcd"}
    assert is_misnamed("quantisation", replace(JOINT, effort=effort), own, more=others) is not is_tested


def test_end_of_a_range_is_flat_and_yielding_is_not():
    data = spring()
    top = float(abs(data.effort).max())
    clipped = replace(data, effort=data.effort.clip(-0.7 * top, 0.7 * top))
    for share, is_end in ((1.0, True), (0.9, False)):  # readings do not continue beyond the end
        assert is_misnamed("saturation", clipped, {"limit": share * 0.7 * top}, 0.01 * top) is not is_end
    data = session(2)
    top = float(data.effort.max())
    given = {"limit": 0.8 * top}
    noise = 0.01 * top * np.random.default_rng(3).standard_normal(len(data.effort))
    cut_off = np.minimum(data.effort, 0.8 * top) + noise
    assert not is_misnamed("saturation", replace(data, effort=cut_off), given, 0.1 * top)
    # Readings a tenth beyond the limit are no noise of a sensor, however large the residual of the model is.
    rough = np.where(data.effort > 0.8 * top, 0.88 * top + noise, data.effort)
    assert is_misnamed("saturation", replace(data, effort=rough), given, 0.1 * top)
    yields = np.minimum(data.effort, 0.8 * top + 0.2 * (data.effort - 0.8 * top))
    assert is_misnamed("saturation", replace(data, effort=yields + 0.1 * noise), given, 0.1 * top)


@pytest.mark.parametrize(
    ("error_m", "goes_on", "is_held"), [(3e-4, 0.0, True), (0.0, 0.7, False), (3e-4, 0.7, False)]
)
def test_force_that_a_controller_holds_is_not_saturated(error_m, goes_on, is_held):
    top_m = 0.009  # here the force is held, or the sensor saturates while the press goes on
    data = session(1)
    time_s, x, v, run = data.time_s, data.position, data.velocity, data.run
    beyond = (x - top_m).clip(0.0)
    force = 800.0 * x.clip(0.0, top_m) + 0.02 * np.random.default_rng(5).standard_normal(len(x))
    path = np.minimum(x, top_m) + goes_on * beyond + error_m * np.sin(9.0 * time_s)
    data = channel(force, time_s, path, v, run)
    problem = fit_model(data, Model("spring", (Stiffness(),)), {}).problem
    model = Model("limited", (Stiffness(), Saturation()))
    solution = solve_gains(problem, model, {"saturation.limit": 800.0 * top_m})
    assert candidates.is_misnamed(model.effect("saturation"), solution, problem) is is_held


@pytest.mark.parametrize("share", [0.0, 0.8, 0.95])
def test_slow_noise_at_the_end_of_a_range_is_no_curve(share):
    rng, count = np.random.default_rng(7), 1500
    time_s, way = 0.01 * np.arange(count), np.linspace(0.0, 1e-2, count)
    flags = 0
    for _ in range(20):
        force = np.minimum(1e3 * way, 9.5) + colored_noise(rng, count, share)  # 75 readings at the end
        data = channel(force, time_s, way, np.full(count, 1e-3), np.zeros(count, dtype=np.int64))
        flags += is_misnamed("saturation", data, {"limit": 9.5})
    assert flags <= 1


@pytest.mark.parametrize(("gap", "is_visible"), [(1.0, False), (1.9, False), (3.0, True)])
def test_gap_within_the_steps_of_an_encoder_is_rounding(gap, is_visible):
    step = 2.0 * np.pi / 4096
    data = replace(JOINT, position=np.round(JOINT.position / step) * step)
    model = Model("geared", (Inertia(), Backlash()))
    problem = fit_model(data, Model("rigid", (Inertia(),)), {}).problem
    shares = {"backlash.motor_inertia": 0.5, "backlash.motor_friction": 0.5}
    solution = solve_gains(problem, model, {"backlash.gap": gap * step, **shares})
    assert candidates.is_misnamed(model.effect("backlash"), solution, problem) is not is_visible


def test_large_tilt_of_one_joint_is_another_center_of_mass():
    turns = replace(JOINT, context={**JOINT.context, "weight_effort_turned": np.ones((len(JOINT), 3))})
    tilt = EFFECTS["gravity_tilt"]().suited_to(turns)
    for roll, is_large in ((0.2, False), (-0.4, True)):
        given = {"gravity_tilt.pitch": 0.1, "gravity_tilt.roll": roll}
        assert tilt.is_misnamed(turns, given, dict, NOISE_N) is is_large
