from dataclasses import replace

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.gate.gate import refuse, usable
from estimation.effects import EFFECTS
from estimation.models import MODELS
from estimation.tare import Tare
from tests.estimation.diagnosis.presses import kelvin_voigt, session
from tests.estimation.diagnosis.test_diagnose import MODEL

DATA = session(3)


def shuffled_where_pressed():
    effort = DATA.effort.copy()
    effort[DATA.engaged] = np.random.default_rng(1).permutation(effort[DATA.engaged])
    return effort


def over_and_over(times):
    """The same runs again and again, slowly sampled, so that each sample is a block."""
    number = np.repeat(np.arange(times), len(DATA))
    again = DATA.select(np.tile(np.arange(len(DATA)), times))
    return replace(
        again,
        time_s=10.0 * again.time_s + 1e4 * number,
        velocity=0.1 * again.velocity,
        run=again.run + 6 * number,
    )


def one_run_again_and_again(data=DATA):
    rows = np.tile(np.flatnonzero(data.run == 0), 4)
    number = np.repeat(np.arange(4), len(rows) // 4)
    return replace(data.select(rows), run=number, time_s=data.time_s[rows] + 10.0 * number)


LONG = over_and_over(300_000 // len(DATA) + 1)
BAD = {
    "never changes": replace(DATA, effort=np.full(len(DATA), 2.0)),
    "single run": replace(DATA, run=np.zeros(len(DATA), dtype=np.int64)),
    "no contact: the displacement": replace(DATA, position=DATA.position - 1.0),
    "no contact: the force": replace(DATA, effort=np.random.default_rng(0).normal(0, 0.05, len(DATA))),
    "millimetres": replace(DATA, position=1e3 * DATA.position, velocity=1e3 * DATA.velocity),
    "check times": replace(DATA, velocity=1e3 * DATA.velocity),
    "sign": replace(DATA, effort=-DATA.effort),
    "at its end": replace(DATA, effort=np.minimum(DATA.effort, 3.0)),
    "too coarse": replace(DATA, effort=4.0 * np.round(DATA.effort / 4.0)),
    "align": replace(DATA, effort=np.roll(DATA.effort, 250)),
    "take some of the runs": LONG,
    "samples": DATA.select(np.arange(50)),
    "only 0 samples": DATA.select(np.arange(0)),
    "is a copy of run 0": one_run_again_and_again(),
    "with its sign": replace(DATA, effort=np.abs(DATA.effort)),
    "resample": DATA.select((DATA.run != 2) | (np.arange(len(DATA)) % 2 == 0)),
    "longer runs": replace(
        DATA, time_s=0.1 * DATA.time_s, velocity=10.0 * DATA.velocity, run=np.arange(len(DATA)) // 8
    ),
    "go on for": replace(DATA, run=np.arange(len(DATA)) // 8),
    "belong together": replace(DATA, effort=shuffled_where_pressed()),
}


@pytest.mark.parametrize("words", BAD)
def test_bad_data_gets_a_reason_and_no_name(words):
    found = diagnose(BAD[words], MODEL, rng=np.random.default_rng(0)).channels[0]
    assert found.verdict is Verdict.INSUFFICIENT
    assert words in found.reason
    assert found.accepted == []


@pytest.mark.parametrize(("correlation", "step_n"), [(0.0, 0.02), (0.6, 0.01), (0.9, 0.001)])
def test_a_copy_is_told_by_its_noise(correlation, step_n):
    again = one_run_again_and_again(session(3, correlation=correlation))
    assert "is a copy of run 0" in refuse(replace(again, effort=step_n * np.round(again.effort / step_n)))


@pytest.mark.parametrize("step_n", [0.0, 1e-6, 0.5])
def test_one_press_made_again_without_noise_is_no_copy(step_n):
    again = one_run_again_and_again()
    force = kelvin_voigt(again.position, again.velocity)
    assert refuse(replace(again, effort=step_n * np.round(force / step_n) if step_n else force)) is None


def test_a_joint_that_is_braked_in_two_runs_is_judged_by_the_others():
    data = swinging()
    braked = (data.run == 1) | (data.run == 2)
    signals = (np.where(braked, at_rest, x) for at_rest, x in ((0.3, data.position), (0.0, data.velocity)))
    position, velocity = signals
    torque = np.where(braked, 0.6, 0.05 * np.round(data.effort / 0.05))
    assert refuse(replace(data, position=position, velocity=velocity, effort=torque)) is None


def test_presses_that_were_not_divided_into_runs_are_to_be_numbered():
    found = diagnose(BAD["single run"], MODEL, rng=np.random.default_rng(0)).channels[0]
    assert f"{len(DATA.runs)} presses" in found.reason
    assert "`run`" in found.reason
    assert "`run`" in found.next_experiment.instruction
    one = DATA.of_runs(DATA.runs[:1])
    assert refuse(one) == "a single run, so nothing can be held out to judge by; probe at least three times"


def test_good_data_passes():
    assert refuse(DATA) is None


@pytest.mark.parametrize("bias_n", [0.0, 0.02, 0.3])
def test_readings_that_were_not_folded_pass(bias_n):
    shifted = DATA.effort - DATA.effort.min() if bias_n == 0.0 else DATA.effort + bias_n
    assert refuse(replace(DATA, effort=shifted)) is None


def test_a_tare_does_not_hide_that_readings_were_folded():
    folded = np.abs(DATA.effort)
    tare = Tare(DATA.runs, np.full(len(DATA.runs), 0.04), np.full(len(DATA.runs), 0.01))
    assert "with its sign" in refuse(replace(DATA, effort=folded - 0.04, tare=tare))


def test_free_air_below_the_range_of_the_sensor_says_nothing_of_the_force():
    assert "lower end" in refuse(replace(DATA, effort=np.maximum(DATA.effort, 1.0)))


ONE_READING_IN_AIR = {
    "a dead band about zero": np.sign(DATA.effort) * np.maximum(np.abs(DATA.effort) - 0.5, 0.0),
    "no force below zero": np.maximum(DATA.effort - 0.5, 0.0),
    "no noise, and an offset": 0.7 + kelvin_voigt(DATA.position, DATA.velocity),
    "steps, and an offset": 0.1 * np.round((DATA.effort - 0.3 * (DATA.position < 0.0)) / 0.1) + 0.5,
    "steps coarser than the noise": 0.2 * np.round(DATA.effort / 0.2) + 0.6,
}


@pytest.mark.parametrize("name", ONE_READING_IN_AIR)
def test_free_air_may_show_one_reading_for_other_reasons(name):
    assert refuse(replace(DATA, effort=ONE_READING_IN_AIR[name])) is None


def test_a_hold_without_noise_is_not_taken_for_the_end_of_the_range():
    held = DATA.position > 0.7 * DATA.position.max()
    x = np.where(held, 0.7 * DATA.position.max(), DATA.position)
    force = 800.0 * np.maximum(x, 0.0) + 0.01 * np.sin(3.0 * DATA.time_s) * (x < 0.0)
    assert np.mean(force[force > 0.3 * force.max()] == force.max()) > 0.3
    assert refuse(replace(DATA, position=x, effort=force, velocity=np.gradient(x, 0.002))) is None


def test_coarse_steps_are_not_taken_for_the_end_of_the_range():
    # held at one depth, the force stays on the last step, which is far from the end of a range
    assert refuse(replace(DATA, effort=0.6 * np.round(DATA.effort / 0.6))) is None


@pytest.mark.parametrize("known", [True, False])
def test_a_handful_of_readings_says_that_they_are_steps_or_that_something_is_left(known):
    coarse = replace(DATA, effort=2.4 * np.round(DATA.effort / 2.4))
    assert len(np.unique(coarse.effort)) == 5
    names = ("saturation", "deadband", "layered_stiffness", "bias", *(["quantisation"] if known else []))
    tried = [EFFECTS[name]() for name in names]
    found = diagnose(coarse, MODEL, tried, rng=np.random.default_rng(0)).channels[0]
    assert [entry.effect for entry in found.accepted] == ["quantisation"] * known
    assert found.verdict is (Verdict.MISSING if known else Verdict.UNEXPLAINED)


def test_a_single_recording_of_a_joint_passes_if_it_repeats_itself():
    t = np.arange(4000) * 0.005
    q = np.sin(2 * np.pi * 0.7 * t)
    again = replace(
        session(3),
        kind=ChannelKind.REVOLUTE,
        time_s=t,
        position=q,
        velocity=np.gradient(q, t),
        acceleration=q,
        effort=q,
        run=np.zeros(4000, dtype=np.int64),
        phase=np.zeros(4000, dtype=np.int64),
    )
    assert refuse(again) is None
    once = replace(again, position=t, velocity=np.ones(4000))
    assert "once" in refuse(once)


def swinging(scale=1.0, seed=0, torque=lambda q, v, a: 0.05 * a + 2.0 * np.sin(q) + 0.1 * v):
    """A pendulum's swings in four runs; `scale` is what its angle is multiplied by when it is recorded."""
    rng = np.random.default_rng(seed)
    t = np.tile(np.arange(2000) * 0.005, 4)
    run = np.repeat(np.arange(4), 2000)
    w = 2.0 + 0.5 * run
    q = 0.9 * np.sin(w * t) + 0.3 * np.sin(0.37 * w * t + run)
    v = 0.9 * w * np.cos(w * t) + 0.111 * w * np.cos(0.37 * w * t + run)
    a = -0.9 * w**2 * np.sin(w * t) - 0.0411 * w**2 * np.sin(0.37 * w * t + run)
    effort = torque(q, v, a) + rng.normal(0, 0.02, len(t))
    motion = (scale * q, scale * v, scale * a)
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, *motion, effort, run, np.full(len(t), -1))


@pytest.mark.parametrize(("scale", "asks"), [(1.0, False), (180.0 / np.pi, True), (100.0, True)])
def test_an_angle_over_several_turns_with_which_the_weight_does_not_come_back_is_in_degrees(scale, asks):
    reason = refuse(swinging(scale), MODELS["pendulum"]().build(ModelContext()))
    assert ("in degrees" in reason) if asks else reason is None


def test_degrees_are_noticed_also_beside_a_model_that_knows_no_weight():
    assert "in degrees" in refuse(swinging(180.0 / np.pi), MODELS["inertia"]().build(ModelContext()))
    assert refuse(swinging(), MODELS["inertia"]().build(ModelContext())) is None


def test_a_spring_wound_up_by_several_turns_and_a_pendulum_that_goes_round_pass():
    spring = swinging(30.0, torque=lambda q, v, a: 3.0 * q + 0.1 * v)
    assert refuse(spring, MODELS["inertia"]().build(ModelContext())) is None
    round_and_round = swinging(
        30.0, torque=lambda q, v, a: 2.0 * np.sin(30.0 * q) + 0.1 * v + 0.2 * np.sign(v)
    )
    assert refuse(round_and_round, MODELS["pendulum"]().build(ModelContext())) is None


SLOW_OVER_SEVERAL_TURNS = {
    "a cable's spring beside a weight": ("pendulum", lambda q, t: 0.2 * np.sin(q) + 0.05 * q),
    "a friction that warms up": ("pendulum", lambda q, t: 0.1 * np.sin(q) + 0.24 * np.exp(-t / 3.0)),
    "a spiral spring": ("inertia", lambda q, t: 0.1 * q + 0.004 * q**2),
}


@pytest.mark.parametrize("name", SLOW_OVER_SEVERAL_TURNS)
def test_what_goes_slowly_with_a_joint_in_radians_is_not_taken_for_degrees(name):
    model, torque = SLOW_OVER_SEVERAL_TURNS[name]
    slow = swinging(10.0)
    t, run = slow.time_s, slow.run
    if "warms" in name:  # round and round, one way
        q = (2.0 + 0.2 * run) * t + 0.1 * (1.0 - np.cos(3.0 * t))
        v = 2.0 + 0.2 * run + 0.3 * np.sin(3.0 * t)
        slow = replace(slow, position=q, velocity=v, acceleration=0.9 * np.cos(3.0 * t))
    noise = np.random.default_rng(1).normal(0, 0.01, len(t))
    effort = 0.002 * slow.acceleration + torque(slow.position, t) + noise
    data = replace(slow, time_s=t + 20.0 * run, effort=effort)
    assert refuse(data, MODELS[model]().build(ModelContext())) is None


@pytest.mark.parametrize(
    ("bend", "words"),
    [
        (np.abs, "turned round"),
        (lambda torque: np.maximum(torque, 0.0), "exactly zero"),
        (lambda torque: np.sign(torque + 1e-9), "2 different readings"),
    ],
)
def test_a_torque_that_lost_its_sign_or_all_but_that_is_refused(bend, words):
    data = swinging()
    assert words in refuse(replace(data, effort=bend(data.effort)))
    assert refuse(data) is None


@pytest.mark.parametrize("step_n", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_a_converter_that_cuts_off_free_air_passes_and_one_that_folds_it_does_not(step_n, correlation):
    made = session(3, correlation=correlation)
    stepped = step_n * np.round(made.effort / step_n) if step_n else made.effort
    assert refuse(replace(made, effort=np.maximum(stepped, 0.0))) is None
    if correlation == 0.0:  # else the noise is less than two steps from sample to sample
        assert "turned round" in refuse(replace(made, effort=np.abs(stepped)))


def test_a_torque_of_one_sign_behind_a_dead_band_passes():
    data = swinging(torque=lambda q, v, a: 2.0 + 1.5 * np.sin(1.6 * q) + 0.1 * v)
    swallowed = replace(data, effort=np.maximum(data.effort - 1.7, 0.0))
    assert np.mean(swallowed.effort == 0.0) > 0.4
    assert refuse(swallowed) is None


def test_a_probing_session_in_which_a_joint_moves_in_one_run_only_says_nothing():
    t = np.tile(np.arange(2000) * 0.002, 2)
    run = np.repeat([0, 1], 2000)
    q = np.where(run == 0, np.sin(5 * t), 0.3)
    v = np.where(run == 0, 5 * np.cos(5 * t), 0.0)
    joint = ChannelData("joint_1", ChannelKind.REVOLUTE, t, q, v, -25 * q, q + np.sign(v), run, run + 1)
    assert "in one run" in refuse(joint)
    assert (
        refuse(replace(joint, phase=np.full(4000, -1))) is None
    )  # not a probing arm's: taken as it was made


def test_glitches_are_set_aside_and_steps_are_kept():
    effort = DATA.effort.copy()
    effort[[300, 900]] = -200.0
    good = usable(replace(DATA, effort=effort))
    assert not good[[300, 900]].any()
    assert good.mean() > 0.99
    step = np.where(np.arange(len(DATA)) > 1000, 5.0, 0.0) + DATA.effort
    assert usable(replace(DATA, effort=step)).all()
