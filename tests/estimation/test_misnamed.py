"""Parameters within their bounds that contradict the name of their effect."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from tests.estimation.presses import channel, colored_noise, session
from tests.estimation.test_effect_form import some_channel

DEPTH_M, NOISE_N = 0.004, 0.05


def is_layer(k, k2, error=0.0, **more):
    """Whether a spring (N/m) and what is added to it at depth are called layers."""
    given = {"stiffness.k": k, "layered_stiffness.k2": k2, "layered_stiffness.depth": DEPTH_M, **more}
    return not EFFECTS["layered_stiffness"]().is_misnamed(
        session(1, runs=4), given, lambda: {"stiffness.k": 1.0, "layered_stiffness.k2": error}, NOISE_N
    )


@pytest.mark.parametrize(("k", "k2"), [(800.0, 700.0), (800.0, -500.0), (40.0, 20000.0), (1500.0, 30.0)])
def test_two_layers_that_both_press_back_are_layers(k, k2):
    assert is_layer(k, k2)


@pytest.mark.parametrize("k", [-9000.0, 0.0, 5.0])
def test_layer_below_nothing_is_a_gap(k):
    assert not is_layer(k, 1500.0)


@pytest.mark.parametrize("k2", [-1500.0, -1498.0, -3000.0])
def test_layer_that_removes_the_whole_spring_is_the_end_of_a_range(k2):
    assert not is_layer(1500.0, k2)


@pytest.mark.parametrize(("error", "layer"), [(20.0, True), (140.0, False), (float("nan"), True)])
def test_insignificant_soft_layer_is_none(error, layer):
    assert is_layer(823.0, -762.0, error) is layer


def test_layered_stiffness_requires_load_depth_and_significance():
    assert is_layer(40.0, 20000.0, error=100.0)  # less stiff than the other is uncertain
    assert is_layer(0.0, 1500.0, **{"cubic_stiffness.k3": 5e7})  # which presses back too
    assert is_layer(0.0, 1500.0, **{"hunt_crossley.k": 4000.0})  # which may carry the load
    assert not is_layer(800.0, 700.0, **{"layered_stiffness.depth": 0.05})


def is_stribeck(rise, speed, transition):
    own = {"coulomb": 0.34, "rise": rise, "speed": speed, "transition": transition}
    given = {f"stribeck_friction.{name}": value for name, value in own.items()}
    data = some_channel(next(iter(EFFECTS["stribeck_friction"].channels)))
    return not EFFECTS["stribeck_friction"]().is_misnamed(data, given, dict, NOISE_N)


@pytest.mark.parametrize(("rise", "speed"), [(0.2, 0.2), (0.05, 0.1), (0.6, 0.03)])
def test_friction_that_rises_towards_rest_is_stribeck_friction(rise, speed):
    assert is_stribeck(rise, speed, transition=0.003)


@pytest.mark.parametrize(("rise", "speed"), [(0.19, 0.0076), (0.19, 0.001), (-0.2, 0.2)])
def test_friction_that_rises_nowhere_is_not_stribeck(rise, speed):
    assert not is_stribeck(rise, speed, transition=0.006)


def test_cubic_part_counts_below_the_kink_too():
    softening = {"cubic_stiffness.k3": -1.5e6}
    assert is_layer(800.0, -500.0)
    assert not is_layer(800.0, -500.0, **softening)


@pytest.mark.parametrize(("width", "layer"), [(2.5, True), (3.15, False), (5.0, False)])
def test_layer_without_a_sensor_reading_is_a_deeper_surface(width, layer):
    assert is_layer(800.0, -500.0, **{"deadband.width": width}) is layer  # it presses with 3.2 N at its end


@pytest.mark.parametrize(
    ("k", "b", "n", "crossley"),
    [(5e4, 1e4, 1.5, True), (0.0, 1e6, 2.0, False), (800.0, 500.0, 1.0, True), (2e5, 0.0, 2.0, True)],
)
def test_damper_that_grows_with_depth_is_not_hunt_crossley(k, b, n, crossley):
    given = {f"hunt_crossley.{name}": value for name, value in {"k": k, "b": b, "n": n}.items()}
    assert EFFECTS["hunt_crossley"]().is_misnamed(session(1), given, dict, NOISE_N) is not crossley


@pytest.mark.parametrize(("fitted_n", "agrees"), [(0.8, True), (0.6, True), (2.0, False), (-0.8, False)])
def test_bias_agrees_with_the_readings_in_free_air(fitted_n, agrees):
    data = session(1, lambda t, x, v, run: 800.0 * x.clip(0.0) + 0.8)
    assert EFFECTS["bias"]().is_misnamed(data, {"bias.offset": fitted_n}, dict, NOISE_N) is not agrees


@pytest.mark.parametrize("noise_n", [0.01, 0.1])
@pytest.mark.parametrize(("hidden_n", "shown"), [(0.5, True), (0.0, False)])
def test_dead_band_is_misnamed_if_readings_do_not_stay_at_zero(hidden_n, shown, noise_n):
    data = session(1, lambda t, x, v, run: 800.0 * x.clip(0.0))
    noise = noise_n * np.random.default_rng(5).standard_normal(len(data))
    data = replace(data, effort=np.maximum(data.effort - hidden_n, 0.0) + noise)
    assert EFFECTS["deadband"]().is_misnamed(data, {"deadband.width": 0.5}, dict, 1.0) is not shown


def test_dead_band_below_the_noise_is_not_judged_by_its_readings():
    data = session(1, lambda t, x, v, run: 800.0 * x.clip(0.0))
    data = replace(data, effort=data.effort + 0.2 * np.random.default_rng(5).standard_normal(len(data)))
    assert not EFFECTS["deadband"]().is_misnamed(data, {"deadband.width": 0.5}, dict, 1.0)


@pytest.mark.parametrize(("width_n", "shown"), [(0.5, True), (50.0, False)])
def test_hysteresis_is_misnamed_if_all_readings_stay_within_its_gap(width_n, shown):
    given = {"hysteresis.width": width_n}
    assert EFFECTS["hysteresis"]().is_misnamed(session(1), given, dict, NOISE_N) is not shown


@pytest.mark.parametrize(("share", "clipped"), [(1.0, True), (0.9, False)])
def test_readings_do_not_continue_beyond_the_end_of_a_range(share, clipped):
    data = session(1, lambda t, x, v, run: 800.0 * x.clip(0.0))
    top = float(abs(data.effort).max())
    data = replace(data, effort=data.effort.clip(-0.7 * top, 0.7 * top))
    given = {"saturation.limit": share * 0.7 * top}
    assert EFFECTS["saturation"]().is_misnamed(data, given, dict, 0.01 * top) is not clipped


def test_end_of_a_range_is_flat_and_yielding_is_not():
    data = session(2)
    top = float(data.effort.max())
    given, saturation = {"saturation.limit": 0.8 * top}, EFFECTS["saturation"]()
    noise = 0.01 * top * np.random.default_rng(3).standard_normal(len(data.effort))
    cut_off = np.minimum(data.effort, 0.8 * top) + noise
    assert not saturation.is_misnamed(replace(data, effort=cut_off), given, dict, 0.1 * top)
    # Readings a tenth beyond the limit are no noise of a sensor, however large the residual of the model is.
    rough = np.where(data.effort > 0.8 * top, 0.88 * top + noise, data.effort)
    assert saturation.is_misnamed(replace(data, effort=rough), given, dict, 0.1 * top)
    yields = np.minimum(data.effort, 0.8 * top + 0.2 * (data.effort - 0.8 * top))
    assert saturation.is_misnamed(replace(data, effort=yields + 0.1 * noise), given, dict, 0.1 * top)


@pytest.mark.parametrize("share", [0.0, 0.8, 0.95])
def test_slow_noise_at_the_end_of_a_range_is_no_curve(share):
    rng, count = np.random.default_rng(7), 1500
    time_s, way = 0.01 * np.arange(count), np.linspace(0.0, 1e-2, count)
    flags = 0
    for _ in range(20):
        force = np.minimum(1e3 * way, 9.5) + colored_noise(rng, count, share)  # 75 readings at the end
        data = channel(force, time_s, way, np.full(count, 1e-3), np.zeros(count, dtype=np.int64))
        flags += EFFECTS["saturation"]().is_misnamed(data, {"saturation.limit": 9.5}, dict, 0.05)
    assert flags <= 1


@pytest.mark.parametrize(("bend_m", "is_seen"), [(1e-6, False), (2e-3, True)])
def test_softening_spring_needs_samples_in_its_bend(bend_m, is_seen):
    given = {"stiffness.k": 800.0, "softening_stiffness.a": 1.0, "softening_stiffness.d": bend_m}
    misnamed = EFFECTS["softening_stiffness"]().is_misnamed(session(1, runs=4), given, dict, NOISE_N)
    assert misnamed is not is_seen


@pytest.mark.parametrize(
    ("delay_s", "plausible"), [(-0.0015, False), (-0.0005, True), (0.03, True), (0.24, True), (0.26, False)]
)
def test_delay_is_less_than_half_of_a_run(delay_s, plausible):
    """With a longer delay the readings hardly show what happens in a run of half a second."""
    data = some_channel(ChannelKind.REVOLUTE)
    is_misnamed = EFFECTS["delay"]().is_misnamed(data, {"delay.time": delay_s}, dict, NOISE_N)
    assert is_misnamed is not plausible
