"""Blocks of a fit, and which of them are scored."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect
from palpate.estimation.effects import EFFECTS
from palpate.estimation.fit.blocks import (
    block_average,
    block_length,
    decimate,
    exclude_boundaries,
    merge_blocks,
)
from palpate.estimation.fit.fit_problem import FitProblem, columns_at, solve_gains
from palpate.estimation.fit.normal_equations import WHITE
from palpate.estimation.model import Model
from tests.estimation.presses import kelvin_voigt
from tests.estimation.swings import long_swings as swings


def recorded(kind, position, effort, *, rate_hz=1000.0, run=None, phase=-1):
    """A channel with exact derivatives as numpy makes them; one run unless `run` says more."""
    time_s = np.arange(len(position)) / rate_hz
    velocity = np.gradient(position, time_s)
    run = np.zeros(len(time_s), dtype=np.int64) if run is None else run
    acceleration, phases = np.gradient(velocity, time_s), np.full(len(time_s), phase)
    return ChannelData("c", kind, time_s, position, velocity, acceleration, effort, run, phases)


def press(seconds=4.0, rate_hz=1000.0, free_m=0.003, shape=np.sin):
    """A press that begins and ends in the air, 10 mm deep, and where its surface is passed."""
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    x = -free_m + 0.013 * np.clip(shape(np.pi * t / seconds), 0.0, 1.0)
    return recorded(ChannelKind.CONTACT, x, kelvin_voigt(x, 0.0 * x), rate_hz=rate_hz)


@pytest.mark.parametrize(
    ("kind", "rate_hz", "effort_hz", "block"),
    [
        *((ChannelKind.CONTACT, rate_hz, 0.5, n) for rate_hz, n in ((1000.0, 5), (600.0, 3), (90.0, 1))),
        *((ChannelKind.REVOLUTE, rate_hz, 0.5, n) for rate_hz, n in ((1000.0, 10), (100.0, 1))),
        # A joint's effort does not oscillate within a block.
        *((ChannelKind.REVOLUTE, 1000.0, effort_hz, n) for effort_hz, n in ((5.0, 10), (15.0, 5), (40.0, 2))),
    ],
)
def test_block_lasts_5_or_10_ms_or_less_where_the_effort_oscillates(kind, rate_hz, effort_hz, block):
    t = np.arange(0.0, 4.003, 1.0 / rate_hz)
    data = recorded(kind, np.sin(3.0 * t), np.sin(2.0 * np.pi * effort_hz * t + 0.3), rate_hz=rate_hz)
    assert block_length(data) == block
    assert block_average(data).rows.shape == (len(t) // block, block)


@pytest.mark.parametrize(("seconds", "block"), [(4.0, 10), (0.5, 5), (0.03, 1)])
def test_short_contact_has_shorter_blocks(seconds, block):
    data = press(seconds, rate_hz=2000.0)
    assert block_length(data) == block
    assert block_length(replace(data, position=data.position - 1.0)) == block  # no contact


def test_joint_effort_noise_is_no_swing():
    t, noise = np.arange(0.0, 4.0, 1e-3), np.random.default_rng(1).normal(0.0, 1.0, 4000)
    assert block_length(recorded(ChannelKind.REVOLUTE, np.sin(3.0 * t), noise)) == 10


@pytest.mark.parametrize(("seconds", "unknown_s"), [(10.0, 0.1), (1.0, 0.05)])
def test_memory_is_unknown_at_the_start_of_a_run(seconds, unknown_s):
    t = np.arange(0.0, seconds, 1e-3)
    data = recorded(ChannelKind.REVOLUTE, np.sin(3.0 * t), np.sin(3.0 * t))
    blocked = block_average(replace(data, time_s=data.time_s + 7.0))
    assert data.time_s[blocked.rows[np.argmax(blocked.trusted), 0]] == pytest.approx(unknown_s, abs=0.01)
    assert blocked.trusted[np.argmax(blocked.trusted) :].all()


def test_folds_are_whole_runs_or_five_parts_of_a_single_run():
    for runs, folds in ((2, 2), (8, 6)):
        several = block_average(swings(1, runs=runs))
        assert several.folds == folds
        assert all(len(set(several.fold[several.run == run])) == 1 for run in range(runs))
    one = block_average(swings(1, runs=1, seconds=10.0))
    assert np.bincount(one.fold).tolist() == [len(one) // 5] * 5
    pieces = np.split(one.fold, np.flatnonzero(np.diff(one.fold)) + 1)
    assert [int(piece[0]) for piece in pieces] == [0, 1, 2, 3, 4] * 3
    two = swings(1, runs=2, seconds=10.0)  # as if there were a single run, where only one has valid samples
    assert block_average(two, two.run == 1).folds == 5


@pytest.mark.parametrize("good_from", [0, 2000])
def test_blocks_with_invalid_samples_are_excluded(good_from):
    data = swings(1, runs=1, seconds=10.0, rate_hz=1000.0)
    blocked = block_average(data, np.arange(len(data)) >= good_from + 5)
    assert not blocked.trusted[blocked.rows[:, 0] < good_from + 5].any()
    assert blocked.trusted[blocked.rows[:, 0] >= max(good_from + 5, 100)].all()


@pytest.mark.parametrize(("phase", "rests"), [(-1, False), (0, True)])
def test_friction_is_not_scored_at_rest_and_motion_start(phase, rests):
    t = np.arange(0.0, 10.0, 1e-3)
    q = np.where(t < 4.0, np.sin(2.0 * np.pi * t), 0.02 * t)  # 6.3 rad/s, then 20 mrad/s
    blocked = block_average(recorded(ChannelKind.REVOLUTE, q, q, phase=phase))
    begun_s = blocked.time_s
    slow = np.abs(blocked.reduce(blocked.data.velocity)) < 0.05 * 6.2
    assert blocked.trusted[~slow & (begun_s > 0.26)].all()
    assert blocked.trusted[slow & (begun_s > 0.26)].any() != rests
    assert blocked.trusted[(begun_s > 0.11) & (begun_s < 0.24)].any() != rests


def test_motion_within_a_step_of_the_position_is_not_scored_at_a_stop():
    """Minimum-jerk moves from -1 to 0 and from 0 to 1 with a stop of 1 s between them."""
    t = np.arange(3000) / 1000.0

    def move(s):
        return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)

    q = np.where(t < 1.5, move(np.minimum(t, 1.0)) - 1.0, move(np.clip(t - 2.0, 0.0, 1.0)))
    fine, coarse = (
        block_average(recorded(ChannelKind.REVOLUTE, one, q)) for one in (q, 1e-3 * np.round(1e3 * q))
    )
    distance = np.abs(q[coarse.rows])
    is_hidden = (distance < 4e-4).all(axis=1) & (distance > 0.0).all(axis=1)
    begun_s = coarse.reduce(t)
    rests = (begun_s > 1.2) & (begun_s < 1.8)
    assert is_hidden.sum() >= 4
    assert not coarse.trusted[is_hidden].any()
    assert coarse.trusted[rests | (distance > 0.05).all(axis=1)][11:-1].all()
    assert fine.trusted[is_hidden].all()


def triangle(angle):
    return np.minimum(angle, np.pi - angle) * 2.0 / np.pi


def test_contact_corner_is_scored_only_where_data_has_nothing_else():
    sharp, round_ = block_average(press(shape=triangle)), block_average(press())
    top = np.abs(sharp.time_s - 2.0)
    assert not sharp.trusted[top < 0.004].any()
    assert sharp.trusted[(top > 0.012) & (top < 0.5)].all()
    assert round_.trusted[top < 0.5].all()
    single = block_average(press(rate_hz=200.0, shape=triangle))  # a sample is a block
    assert np.sum(~single.trusted[350:450]) == 9  # the corner, its neighbours, and three more to either side
    slow = block_average(press(seconds=40.0, rate_hz=50.0, shape=triangle))
    assert slow.trusted[np.abs(slow.time_s - 20.0) < 5.0].all()


def test_blocks_within_the_surface_error_are_excluded():
    data = press()
    noisy = replace(data, position=data.position + np.random.default_rng(1).normal(0.0, 2e-4, len(data)))
    nearest = [
        np.abs(one.data.position[one.rows[one.trusted]]).min() for one in map(block_average, (data, noisy))
    ]
    assert nearest[0] < 1.5e-4
    assert 3.9e-4 < nearest[1] < 7.5e-4


def test_coarse_copy_has_one_sample_per_block():
    data = replace(swings(1, rate_hz=1000.0), context={"temperature_c": np.arange(15_000.0)})
    copy = decimate(block_average(data))
    assert (len(copy), copy.name, copy.kind) == (1500, data.name, data.kind)
    for name in ("time_s", "position", "velocity", "acceleration", "effort"):
        assert getattr(copy, name) == pytest.approx(getattr(data, name).reshape(-1, 10).mean(axis=1))
    assert copy.context["temperature_c"] == pytest.approx(4.5 + 10.0 * np.arange(1500))
    np.testing.assert_array_equal(copy.run, data.run[::10])
    press_copy = decimate(block_average(replace(press(), touching=np.arange(4000) >= 1000)))
    assert press_copy.touching.tolist() == [False] * 200 + [True] * 600
    assert decimate(block_average(replace(data, phase=np.arange(15_000)))).phase[:3].tolist() == [0, 10, 20]


def stepping(times, run=None):
    """A deep contact at 200 Hz, a sample to a block, whose velocity steps down and up at these samples."""
    speed = np.zeros(800)
    for number, at in enumerate(times):
        speed[at:] = -1.0 if number % 2 else 1.0
    data = recorded(ChannelKind.CONTACT, np.full(800, 0.05), np.ones(800), rate_hz=200.0, run=run)
    return replace(data, velocity=speed + 0.05 * np.sin(np.arange(800) / 5.0))


@pytest.mark.parametrize(
    ("times", "sharp"),
    [
        ((400,), [*range(396, 404)]),  # a jump from one sample to the next, and three to either side
        ((400, 403), [*range(396, 407)]),
        ((798,), [*range(794, 800)]),
        (range(100, 800, 40), 18 * 8),  # a fifth of all blocks
        (range(100, 800, 34), 0),  # more: so coarsely sampled that there is nothing else
    ],
)
def test_samples_at_velocity_jumps_are_excluded(times, sharp):
    lost = np.flatnonzero(~block_average(stepping(times)).trusted[20:]) + 20
    assert (lost.tolist() if isinstance(sharp, list) else len(lost)) == sharp


def test_jump_between_runs_is_no_corner():
    assert block_average(stepping((400,), np.repeat([0, 1], 400))).trusted[380:400].all()


@pytest.mark.parametrize(("averaged", "share"), [(1, 0.0), (2, 1.0)])
def test_corner_is_a_velocity_jump_between_readings(averaged, share):
    speeds = np.linspace(0.0, 0.9, 800) + 0.1 * (np.arange(800) >= 400)
    data = replace(stepping(()), velocity=speeds, averaged=averaged)
    assert block_average(data).trusted[396:404].mean() == share


@pytest.mark.parametrize(("averaged", "lost"), [(1, [40]), (4, [39, 40])])
def test_means_next_to_the_surface_are_excluded(averaged, lost):
    """Which reading passed it is not known."""
    depth = np.where(np.arange(100) < 40, -0.01, 0.01)
    data = replace(
        recorded(ChannelKind.CONTACT, depth, depth, rate_hz=50.0, run=np.repeat([0, 1], 50)),
        averaged=averaged,
        position_step=1e-6,
    )
    assert np.flatnonzero(~block_average(data).trusted[10:45]).tolist() == [one - 10 for one in lost]


@pytest.mark.parametrize(("again", "taken"), [(12, False), (11, True)])
def test_press_without_its_start_is_scored_if_most_are_such(again, taken):
    depth = np.full(200, -0.01)
    depth[:100] = depth[150 : 150 + again] = 0.01
    data = recorded(ChannelKind.CONTACT, depth, depth, rate_hz=50.0)
    blocked = block_average(replace(data, position_step=1e-6))
    assert blocked.trusted[20:99].all() == blocked.trusted[20:99].any() == taken
    assert blocked.trusted[102:149].all()


def test_blocks_share_load_independent_parts_and_recompute_the_rest():
    data = replace(swings(1, runs=1), context={"load": np.ones(750)})
    one = block_average(data)
    two = block_average(replace(data, context={"load": np.full(750, 3.0)}), cache=one.cache)
    viscous, loaded = EFFECTS["viscous_friction"](), EFFECTS["load_dependent_friction"]()
    model = Model("m", (viscous, loaded))
    inner = {"load_dependent_friction.transition": 0.01, "load_dependent_friction.link_share": 1.0}
    assert two.parts(viscous, model, inner) is one.parts(viscous, model, inner)
    assert two.parts(loaded, model, inner) == pytest.approx(3.0 * one.parts(loaded, model, inner))
    assert one.parts(loaded, model, inner) is one.parts(loaded, model, inner)


def test_joined_blocks_keep_their_runs_folds_and_means():
    blocked = block_average(swings(1, runs=3, rate_hz=100.0))
    joined = merge_blocks(blocked, len(blocked) // 4)
    assert len(joined) == len(blocked) // 4
    assert joined.reduce(blocked.data.position) == pytest.approx(
        blocked.reduce(blocked.data.position).reshape(-1, 4).mean(axis=1)
    )
    assert np.array_equal(joined.run, blocked.run[::4])
    assert np.array_equal(joined.fold, blocked.fold[::4])
    assert np.array_equal(joined.trusted, blocked.trusted.reshape(-1, 4).all(axis=1))
    assert all(len(np.unique(blocked.data.run[rows])) == 1 for rows in joined.rows)
    assert merge_blocks(blocked, len(blocked)) is blocked
    wave = np.sin(2.0 * np.pi * 12.0 * blocked.data.time_s)
    waving = block_average(replace(blocked.data, effort=wave))
    assert len(merge_blocks(waving, len(waving) // 4)) == len(waving) // 2  # four blocks are half a period


@pytest.mark.parametrize(
    ("names", "parameters"),
    [
        (("viscous_friction", "delay"), {"delay.time": 0.013}),
        (("viscous_friction", "torque_gain", "lag"), {"torque_gain.gain": 1.2, "lag.tau": 0.02}),
        (
            ("backlash", "coulomb_friction"),
            {
                "backlash.gap": 0.05,
                "backlash.motor_inertia": 0.0,
                "backlash.motor_friction": 0.3,
                "coulomb_friction.transition": 0.01,
            },
        ),
    ],
)
def test_column_on_blocks_passes_through_motion_and_sensor_effects(names, parameters):
    blocked = block_average(swings(1, runs=2))
    model = Model("m", tuple(EFFECTS[name]() for name in ("inertia", *names)))
    parameters = {name: inner.beginning for name, inner in model.inner.items()} | parameters
    slopes, _ = model.linearize(blocked.data, {**dict.fromkeys(model.gains, 1.0), **parameters})
    columns = columns_at(FitProblem(blocked, WHITE), model, parameters)
    np.testing.assert_allclose(columns, blocked.reduce(slopes), rtol=1e-9, atol=1e-12)


def test_samples_on_both_sides_of_the_touch_of_a_recovering_surface_are_excluded():
    data = press()
    blocked = block_average(data)
    deepest = int(np.argmax(blocked.reduce(data.position)))
    recovering = np.arange(len(data)) <= blocked.rows[deepest, -1]
    excluded = [exclude_boundaries(blocked, data, mask).trusted for mask in (None, recovering)]
    np.testing.assert_array_equal(np.flatnonzero(excluded[0] & ~excluded[1]), [deepest, deepest + 1])


def test_full_rate_columns_are_known_only_on_the_measured_motion():
    blocked = block_average(swings(1, runs=1))
    coulomb, inner = EFFECTS["coulomb_friction"](), {"coulomb_friction.transition": 0.01}
    model = Model("test", (coulomb,))
    moved = replace(blocked.data, velocity=-blocked.data.velocity)
    first = blocked.at_full_rate(model, coulomb, blocked.data, inner)
    assert blocked.at_full_rate(model, coulomb, blocked.data, inner) is first
    np.testing.assert_allclose(blocked.at_full_rate(model, coulomb, moved, inner), -first)


def test_full_rate_columns_follow_the_effects_that_move_the_surface():
    data = press()
    blocked, stiffness = block_average(data), EFFECTS["stiffness"]()
    model = Model("test", (stiffness, EFFECTS["contact_offset"]()))
    near, far = ({"contact_offset.offset": offset} for offset in (1e-4, 1e-3))
    first = blocked.at_full_rate(model, stiffness, model.moved(data, near), near)
    other = blocked.at_full_rate(model, stiffness, model.moved(data, far), far)
    assert blocked.at_full_rate(model, stiffness, model.moved(data, near), near) is first
    np.testing.assert_allclose(first, model.columns(stiffness, model.moved(data, near), near))
    assert not np.allclose(first, other)


def test_full_rate_columns_follow_the_load_that_bends_a_joint():
    """The load depends on the model, and blocks with different loads share a cache."""
    data, spring = swings(1, runs=1), EFFECTS["joint_spring"]()
    model = Model("test", (spring, EFFECTS["joint_elasticity"]()))
    inner = {"joint_elasticity.compliance": 0.01}
    blocked = block_average(replace(data, context={"load": data.effort}))
    for each in (blocked, replace(blocked, data=replace(data, context={"load": 9.0 * data.effort}))):
        moved = model.moved(each.data, inner)
        columns = each.at_full_rate(model, spring, moved, inner)
        np.testing.assert_allclose(columns, model.columns(spring, moved, inner))


def test_full_rate_columns_are_known_for_each_memory_that_relaxes_them():
    """Only elastic columns depend on the memory."""
    data = press()
    blocked = block_average(data)
    stiffness, damping, memory = (EFFECTS[n]() for n in ("stiffness", "damping", "power_law_relaxation"))
    model = Model("test", (stiffness, damping, memory))
    fast, slow = (
        {"power_law_relaxation.share": 0.5, "power_law_relaxation.alpha": alpha} for alpha in (0.3, 0.6)
    )
    first = blocked.at_full_rate(model, stiffness, data, fast)
    assert blocked.at_full_rate(model, stiffness, data, fast) is first
    np.testing.assert_allclose(first, model.columns(stiffness, data, fast))
    other = blocked.at_full_rate(model, stiffness, data, slow)
    np.testing.assert_allclose(other, model.columns(stiffness, data, slow))
    assert not np.allclose(first, other)
    rates = [blocked.at_full_rate(model, damping, data, inner) for inner in (fast, slow)]
    assert rates[0] is rates[1]


class _Known(AdditiveEffect):
    """A torque that is known, as that of a rigid body from a URDF: it has no gain."""

    name = "known"

    def columns(self, data, inner):
        return np.empty((len(data), 0))

    def known(self, data, inner):
        return np.sin(3.0 * data.time_s)


@pytest.mark.parametrize("sensor", ["delay", "lag"])
def test_effect_without_gains_passes_through_a_sensor(sensor):
    blocked = block_average(swings(1, runs=2))
    model = Model("m", (EFFECTS["inertia"](), _Known(), EFFECTS[sensor]()))
    parameters = {**dict.fromkeys(model.gains, 0.0), **dict.fromkeys(model.inner, 0.02)}
    solution = solve_gains(FitProblem(blocked, WHITE), model, parameters)
    expected = blocked.effort - blocked.reduce(model.predict(blocked.data, solution.parameters))
    np.testing.assert_allclose(solution.residual, expected, atol=1e-9)
