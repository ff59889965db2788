"""Data quality: rejections and warnings with figure and remedy, and harmless anomalies."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.channel import ChannelData, ChannelKind, Tare
from palpate.estimation.data.import_files import joined_channels
from palpate.estimation.data_quality import (
    checklist,
    contaminated,
    list_warnings,
    quality_warnings,
    reject_reason,
    usable,
)
from palpate.estimation.data_quality.motion_and_effort import at_rest, late_touch
from palpate.estimation.models import MODELS
from palpate.estimation.study.estimates import estimate_with
from tests.estimation.presses import RATE_HZ, channel, kelvin_voigt
from tests.estimation.presses import long_session as session

DATA = session(3)
X, F, COUNT = DATA.position, DATA.effort, np.arange(len(DATA))


def model(name):
    return MODELS[name]().build(ModelContext())


def shuffled_in_contact():
    effort = F.copy()
    effort[DATA.engaged] = np.random.default_rng(1).permutation(effort[DATA.engaged])
    return effort


def very_long():
    """The same motion again and again, slowly sampled, so that each sample is a block."""
    times = 300_000 // len(DATA) + 1
    number = np.repeat(np.arange(times), len(DATA))
    again = DATA.select(np.tile(COUNT, times))
    time_s, run = 10.0 * again.time_s + 1e4 * number, again.run + 6 * number
    effort = again.effort + np.random.default_rng(0).normal(0, 0.2, len(again))  # else they were copies
    return replace(again, time_s=time_s, velocity=0.1 * again.velocity, effort=effort, run=run)


def copies(data=DATA):
    """Four times the first run."""
    rows = np.tile(np.flatnonzero(data.run == 0), 4)
    number = np.repeat(np.arange(4), len(rows) // 4)
    return replace(data.select(rows), run=number, time_s=data.time_s[rows] + 10.0 * number)


def swinging(scale=1.0, torque=lambda q, v, a: 0.05 * a + 2.0 * np.sin(q) + 0.1 * v):
    """A pendulum's swings in four runs; `scale` is what its angle is multiplied by when it is recorded."""
    rng = np.random.default_rng(0)
    t, run = np.tile(np.arange(2000) * 0.005, 4), np.repeat(np.arange(4), 2000)
    w = 2.0 + 0.5 * run
    q = 0.9 * np.sin(w * t) + 0.3 * np.sin(0.37 * w * t + run)
    v = 0.9 * w * np.cos(w * t) + 0.111 * w * np.cos(0.37 * w * t + run)
    a = -0.9 * w**2 * np.sin(w * t) - 0.0411 * w**2 * np.sin(0.37 * w * t + run)
    effort = torque(q, v, a) + rng.normal(0, 0.02, len(t))
    motion = (scale * q, scale * v, scale * a)
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, *motion, effort, run, np.full(len(t), -1))


def one_recording(position):
    """A joint that was recorded in one run of 20 s."""
    t, one = np.arange(4000) * 0.005, np.zeros(4000, dtype=np.int64)
    q = position(t)
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, q, np.gradient(q, t), q, q, one, one - 1)


def moving_in_one_run(phase):
    t, run = np.tile(np.arange(2000) * 0.002, 2), np.repeat([0, 1], 2000)
    q = np.where(run == 0, np.sin(5 * t), 0.3)
    v = np.where(run == 0, 5 * np.cos(5 * t), 0.0)
    phase = np.full(4000, phase)
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, q, v, -25 * q, q + np.sign(v), run, phase)


def with_lost_sign(friction):
    """A joint without weight, whose recorded torque is an absolute value."""
    data = swinging()
    effort = 0.02 * data.acceleration + 0.1 * data.velocity + friction * np.sign(data.velocity)
    noise = np.random.default_rng(1).normal(0.0, 0.005, len(data))
    return replace(data, effort=np.abs(effort + noise))


def glitch_in_each_block():
    """A press sampled at 20 kHz; every block of 5 ms holds one reading far off its neighbors."""
    t, run = np.tile(np.arange(20_000) / 20e3, 4), np.repeat(np.arange(4), 20_000)
    w = 8.0 * np.pi
    x, v, a = 1e-3 * (1.0 - np.cos(w * t)), 1e-3 * w * np.sin(w * t), 1e-3 * w**2 * np.cos(w * t)
    effort = 3e3 * x + np.random.default_rng(0).normal(0.0, 0.02, len(t))
    effort[50::100] += 50.0
    return ChannelData("contact", ChannelKind.CONTACT, t + run, x, v, a, effort, run, run * 0 - 1)


def press(**changes):
    """Makes a press with these signals in the place of its own."""
    return partial(replace, DATA, **changes)


SHORT_RUNS = {"time_s": 0.1 * DATA.time_s, "velocity": 10.0 * DATA.velocity}
REJECTED = {
    "never changes": press(effort=np.full(len(DATA), 2.0)),
    "no two of 6 runs have similar depths": press(position=X + DATA.run * np.ptp(X)),
    "none can be predicted from the others": press(position=X + 0.95 * DATA.run * np.ptp(X)),
    "of 6 touches the object; record at least three that do": press(
        position=np.where(DATA.run == 0, X, X - 1.0), effort=np.where(DATA.run == 0, F, 0.0)
    ),
    "no contact: the displacement": press(position=X - 1.0),
    "no contact: the force": press(effort=np.random.default_rng(0).normal(0, 0.05, len(X))),
    "check times and units": press(velocity=1e3 * DATA.velocity),
    "check the sign": press(effort=-F),
    "too coarse": press(effort=4.0 * np.round(F / 4.0)),
    "2 different readings": lambda: replace(swinging(), effort=1.0 + np.sign(swinging().effort)),
    "runs with --where run=N,N": very_long,
    "take shorter recordings": lambda: replace(very_long(), run=np.zeros(len(very_long()), np.int64)),
    "record at least 60": lambda: DATA.select(COUNT[:59]),
    "only 0 samples": lambda: DATA.select(COUNT[:0]),
    "was rectified; record the effort with its sign": lambda: replace(
        swinging(), effort=np.abs(swinging().effort)
    ),
    "recorded as an absolute value": lambda: with_lost_sign(0.3),
    "negative readings were probably cut off": lambda: replace(
        swinging(), effort=np.maximum(swinging().effort, 0.0)
    ),
    "at least two runs must have": press(**SHORT_RUNS, run=np.maximum(COUNT - 1500, 0) // 5),
    "at least two runs must last": press(run=COUNT // 8),
    "at most one run has motion": lambda: moving_in_one_run(phase=1),
    "800 readings are excluded": glitch_in_each_block,
    f"{-(-len(DATA) // 60)} readings of the effort are far from their neighbors, such as -9999 N": press(
        effort=np.where(COUNT % 60 == 0, -9999.0, F)
    ),
    "effort is far from its neighbors, such as 1e+12 N": press(effort=np.where(COUNT == 900, 1e12, F)),
    "1 reading of the position is far from its neighbors": press(position=np.where(COUNT == 900, -0.999, X)),
}


@pytest.mark.parametrize("words", REJECTED)
def test_unusable_data_are_rejected_with_a_remedy(words):
    assert words in reject_reason(REJECTED[words]())


@pytest.mark.parametrize(("averaged", "is_rejected"), [(1, True), (2, False)])
def test_uneven_averages_do_not_reject_the_velocity_scale(averaged, is_rejected):
    """An uneven recording whose readings were averaged in pairs: their velocity seems twice too large."""
    uneven = swinging()
    uneven = uneven.select(np.random.default_rng(0).random(len(uneven)) < 0.7)
    data = replace(uneven, velocity=2.0 * uneven.velocity, averaged=averaged)
    assert ("check times and units" in (reject_reason(data) or "")) == is_rejected


@pytest.mark.parametrize("still", ["position", "effort"])
def test_constant_signal_is_not_reported_further(still):
    data = replace(DATA, **{still: np.full(len(DATA), 2.0)})
    assert reject_reason(data) == f"the {still} never changes; check the sensor and the column"
    assert quality_warnings(data) == []


def in_millimetres():
    return replace(DATA, position=1e3 * X, velocity=1e3 * DATA.velocity, acceleration=1e3 * DATA.acceleration)


IMPLAUSIBLE = {  # what is said of it, and how often
    f"the deepest indentation is {1e3 * X.max():.3g} m, more than 0.2 m; if": in_millimetres,
    f"force over depth is {1e7 * np.ptp(F) / X.max():.3g} N/m, outside": press(effort=1e7 * F),
    "faster than 300 rad/s: a tenth of the samples exceed 551 rad/s": lambda: replace(
        swinging(), position=200.0 * swinging().position, velocity=200.0 * swinging().velocity
    ),
    "90 % of the loaded samples show 3 N: the sensor is saturated": press(effort=np.minimum(F, 3.0)),
    "of the loaded samples show -0.9 N m: the sensor is saturated": lambda: replace(
        swinging(), effort=np.maximum(swinging().effort, -0.9)
    ),
    "of the samples in free air are exactly 1 N, and none is lower": press(effort=np.maximum(F, 1.0)),
    "the force is 0.5 s late relative to the motion (correlation 0.99": press(effort=np.roll(F, 250)),
    "the signal was rectified, and": press(effort=np.abs(F)),
    "was one column used for both?": press(effort=0.5 * DATA.position),
    "explain only 0 % of the force; is the right column read as the force?": press(
        effort=shuffled_in_contact()
    ),
    "only one run was recorded, and it goes through its motion once, so changes": lambda: DATA.of_runs(
        DATA.runs[:1]
    ),
    "cannot be separated; record at least three runs": lambda: one_recording(lambda t: t),
    "run 1 is a copy of run 0 (one of 3 copies): 100 % of its noise": copies,
    "its neighbors, such as 500 N at 0.2 s; diagnosis": press(effort=np.where(COUNT == 100, 500.0, F)),
    "far from their neighbors, such as 0 N": press(effort=np.where((COUNT % 30 == 7) & DATA.engaged, 0.0, F)),
    "run 6 is a copy of run 0: 100 % of its noise": lambda: joined(DATA, DATA.of_runs(DATA.runs[:1])),
}


@pytest.mark.parametrize("count", [19, 20])
def test_no_share_of_free_air_is_stated_for_a_few_samples(count):
    limited = replace(DATA, effort=np.maximum(F, 1.0))
    few = limited.select(np.flatnonzero(DATA.engaged | (np.cumsum(~DATA.engaged) <= count)))
    assert any("of the samples in free air" in warning for warning in quality_warnings(few)) == (count == 20)


@pytest.mark.parametrize(
    ("depth_share", "force_share", "is_doubtful"), [(1e-4, 1e-9, False), (1.0, 1e-5, True)]
)
def test_soft_cantilever_cell_needs_no_other_unit(depth_share, force_share, is_doubtful):
    """Micrometers and nanonewtons give some mN/m; as much over millimeters is a mistake."""
    motion = {name: depth_share * getattr(DATA, name) for name in ("position", "velocity", "acceleration")}
    warnings = quality_warnings(replace(DATA, effort=force_share * F, **motion))
    assert any("force over depth is" in warning for warning in warnings) == is_doubtful


@pytest.mark.parametrize(
    ("depth", "is_constant_force"),
    [
        (lambda share: share, True),  # a pull at one speed
        (lambda share: share**2, False),  # a pull that becomes faster
        (lambda share: 1.0 - np.abs(2.0 * share - 1.0), False),  # and back: the damper's force reverses
    ],
)
def test_damper_acts_like_a_constant_force_in_a_pull_at_one_speed(depth, is_constant_force):
    share = np.linspace(0.0, 1.0, 2000)
    x = 0.005 * (0.01 + depth(share))
    pull = channel(300.0 * x, 0.01 * np.arange(2000), x, np.gradient(x, 0.01), np.zeros(2000, np.intp))
    said = " ".join(quality_warnings(pull))
    assert ("a damper acts like a constant force" in said) == is_constant_force


def joined(first, second):
    """Runs of the second after those of the first."""
    return joined_channels([first, replace(second, time_s=second.time_s + 100.0)])


@pytest.mark.parametrize("words", IMPLAUSIBLE)
def test_implausible_data_are_reported_and_diagnosed(words):
    data = IMPLAUSIBLE[words]()
    assert reject_reason(data) is None
    assert words in " ".join(quality_warnings(data))
    assert quality_warnings(data)[0] in checklist(data).values()


def test_missing_value_codes_are_neither_a_unit_nor_saturation():
    data = replace(DATA, position=np.where(COUNT % 60 == 0, -0.999, X))
    assert quality_warnings(data) == []
    assert "are far from" in checklist(data)["readings"]
    assert "are far from" in contaminated(data, model("kelvin_voigt"))


def test_plausible_data_give_no_warning():
    assert contaminated(DATA.of_runs(DATA.runs[:1]), model("kelvin_voigt")) is None
    assert quality_warnings(DATA) == []
    assert quality_warnings(swinging(), model("pendulum")) == []
    assert reject_reason(replace(DATA, run=0 * DATA.run)) is None


def test_damper_under_a_sine_is_in_step_with_its_force():
    t, run = np.tile(np.arange(2000) * 0.005, 4), np.repeat(np.arange(4), 2000)
    x, v = 0.01 * np.sin(np.pi * t), 0.01 * np.pi * np.cos(np.pi * t)
    force = 200.0 * v + np.random.default_rng(0).normal(0.0, 0.01, len(t))
    data = ChannelData("contact", ChannelKind.CONTACT, t, x, v, -(np.pi**2) * x, force, run, 0 * run - 1)
    both_ways = replace(data, touching=np.ones(len(t), dtype=np.bool_))
    assert not [warning for warning in quality_warnings(both_ways) if "align" in warning]
    assert reject_reason(both_ways) is None


def coarsely_read(step, noise=0.0):
    """A pendulum whose angle was read in steps; its velocity was measured by another sensor."""
    data = swinging()
    read = data.position + noise * np.random.default_rng(4).standard_normal(len(data))
    return replace(data, position=step * np.round(read / step) if step else read)


def cut_hold():
    """A hold without noise shows one reading all along."""
    x = np.minimum(X, 0.7 * X.max())
    force = 800.0 * np.maximum(x, 0.0) + 0.01 * np.sin(3.0 * DATA.time_s) * (x < 0.0)
    assert np.mean(force[force > 0.3 * force.max()] == force.max()) > 0.3
    return replace(DATA, position=x, effort=force, velocity=np.gradient(x, 0.002))


def braked_in_two_runs():
    data = swinging()
    braked = (data.run == 1) | (data.run == 2)
    q, v = np.where(braked, 0.3, data.position), np.where(braked, 0.0, data.velocity)
    return replace(data, position=q, velocity=v, effort=np.where(braked, 0.6, data.effort.round(1)))


def at_rates(*every):
    """Runs of which only every so many samples are kept."""
    return DATA.select(COUNT % np.array(every)[DATA.run % len(every)] == 0)


def logarithmic_in_time():
    """Ramps of 0.1 to 100 s and their holds, of a hundred samples each."""
    parts = []
    for run, ramp_s in enumerate((0.1, 1.0, 10.0, 100.0)):
        t = np.concatenate([np.linspace(0, ramp_s, 40), ramp_s + np.geomspace(0.01, 60, 80)])
        x = 2e-4 * np.minimum(t / ramp_s, 1.0)
        v = np.where(t <= ramp_s, 2e-4 / ramp_s, 0.0)
        parts.append((t + 300.0 * run, x, v, np.full(len(t), run)))
    t, x, v, run = (np.concatenate(part) for part in zip(*parts, strict=True))
    f = 40.0 * x + np.random.default_rng(0).normal(0, 2e-4, len(t))
    return ChannelData("contact", ChannelKind.CONTACT, t, x, v, 0 * v, f, run, 0 * run - 1)


def one_signed_behind_a_dead_band():
    data = swinging(torque=lambda q, v, a: 2.0 + 1.5 * np.sin(1.6 * q) + 0.1 * v)
    swallowed = replace(data, effort=np.maximum(data.effort - 1.7, 0.0))
    assert np.mean(swallowed.effort == 0.0) > 0.4
    return swallowed


def static_levels():
    """Five weights on a force sensor, up and down; the velocity of the levels is zero."""
    level = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0], 40)
    t, still, run = 0.1 * np.arange(len(level)), np.zeros(len(level)), np.arange(len(level)) // 80
    effort = 2.0 + 50.0 * level + np.random.default_rng(0).normal(0.0, 0.1, len(t))
    return ChannelData("cell", ChannelKind.PRISMATIC, t, 0.01 * level, still, still, effort, run, 0 * run - 1)


def stepped(force, step):
    return step * np.round(force / step) if step else force


EXACT = kelvin_voigt(X, DATA.velocity)
JUDGED = {
    "presses": lambda: DATA,
    "swings": swinging,
    "a joint's single recording that repeats itself": lambda: one_recording(np.sin),
    "a joint that is braked in two runs": braked_in_two_runs,
    "a recording that is no probing arm's": lambda: moving_in_one_run(phase=-1),
    "rates a factor of ten apart": lambda: at_rates(1, 3, 10),
    "times over three decades": logarithmic_in_time,
    "steps of 64 a turn": lambda: coarsely_read(2 * np.pi / 64),
    "noise and steps": lambda: coarsely_read(0.02, noise=0.02),
    "a depth in steps": press(position=stepped(X, 3e-4)),
    "a velocity that noise is in": press(
        velocity=DATA.velocity + np.random.default_rng(0).normal(0, 0.03, len(X))
    ),
    "a zero beyond the readings": press(effort=F - F.min()),
    "a zero a little off": press(effort=F + 0.02),
    "a dead band about zero": press(effort=np.sign(F) * np.maximum(np.abs(F) - 0.5, 0.0)),
    "no force below zero": press(effort=np.maximum(F - 0.5, 0.0)),
    "no noise, and an offset": press(effort=0.7 + EXACT),
    "steps, and an offset": press(effort=stepped(F - 0.3 * (X < 0), 0.1) + 0.5),
    "steps coarser than the noise": press(effort=stepped(F, 0.2) + 0.6),
    "coarse steps, often at the last": press(effort=stepped(F, 0.6)),
    "a hold without noise": cut_hold,
    "one press made again without noise": lambda: replace(
        copies(), effort=copies(replace(DATA, effort=EXACT)).effort
    ),
    "the same in large steps": lambda: copies(replace(DATA, effort=stepped(EXACT, 0.5))),
    "levels without a motion between them": static_levels,
    "one sign behind a dead band": one_signed_behind_a_dead_band,
}


@pytest.mark.parametrize("name", JUDGED)
def test_harmless_anomalies_do_not_prevent_a_diagnosis(name):
    assert reject_reason(JUDGED[name]()) is None


def test_velocity_that_was_derived_is_not_rejected():
    """In some recordings, noise of the position exceeds its motion within the smoothing window."""
    data = press(velocity=np.random.default_rng(0).normal(0.0, 1.0, len(X)))()
    assert "does not follow the position" in reject_reason(data)
    assert not reject_reason(replace(data, units={"time": "s", "displacement": "m", "force": "N"}))


@pytest.mark.parametrize(("factor", "step"), [(0.1, 0.05), (0.5, 0.0), (2.0, 0.05), (30.0, 0.0)])
def test_wrong_velocity_is_detected_through_encoder_steps(factor, step):
    data = coarsely_read(step)
    reason = reject_reason(replace(data, velocity=factor * data.velocity))
    assert float(reason.split()[3]) == pytest.approx(factor, rel=0.05)
    assert "check times" in contaminated(replace(data, time_s=data.time_s / factor), model("pendulum"))


@pytest.mark.parametrize(("correlation", "step_n"), [(0.0, 0.02), (0.6, 0.01), (0.9, 0.001)])
def test_copied_run_is_detected_by_its_noise(correlation, step_n):
    again = copies(session(3, correlation=correlation))
    again = replace(again, effort=stepped(again.effort, step_n))
    assert "is a copy of run 0 (one of 3 copies): 100 %" in quality_warnings(again)[0]
    (told,) = list_warnings((name, quality_warnings(again)[:1]) for name in ("joint_1", "joint_2"))
    assert told.startswith("joint_1, joint_2: run ")
    assert set(again.run[usable(again)]) == {0}


@pytest.mark.parametrize("step_n", [0.0, 1e-6, 0.5])
def test_equal_run_without_noise_is_left_out(step_n):
    """Two runs at their own speeds, and each of them twice."""
    exact = replace(DATA, effort=stepped(EXACT, step_n)).of_runs(DATA.runs[:2])
    again = joined(exact, exact)
    (told,) = (warning for warning in quality_warnings(again) if "copy" in warning)
    assert (
        "of run 0 (one of 2 copies): all of its readings are the same, so run 2 adds no information" in told
    )
    assert set(again.run[usable(again)]) == {0, 1}
    assert reject_reason(again) is None


def test_spring_at_another_speed_is_no_copy():
    """A spring without noise has equal readings at every speed."""
    first = replace(DATA, effort=800.0 * np.maximum(X, 0.0)).of_runs(DATA.runs[:1])
    faster = replace(first, time_s=0.5 * first.time_s, velocity=2.0 * first.velocity)
    assert usable(joined(first, faster)).all()


def test_copied_runs_do_not_narrow_intervals():
    """Four times one run, with differences far below its noise, say no more than the run itself."""
    many = copies()
    many = replace(many, effort=many.effort + np.random.default_rng(1).normal(0.0, 0.002, len(many)))
    of_one, of_four = (
        {p.name: p for p in estimate_with(data, "kelvin_voigt", ["lsq"]).estimates[0].parameters}
        for data in (many.select(many.run == 0), many)
    )
    for name, parameter in of_one.items():
        assert of_four[name].std_err == pytest.approx(parameter.std_err, rel=1e-6)
        assert of_four[name].value == pytest.approx(parameter.value, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "correlation"),
    [
        (lambda force, noise: force + 0.2 * noise, 0.6),
        (lambda force, noise: 1.01 * force + 0.05, 0.0),
        (lambda force, noise: np.round(force, 2), 0.6),
    ],
    ids=["noise added", "scaled and offset", "rounded"],
)
def test_copy_that_differs_by_less_than_its_noise_is_left_out(change, correlation):
    data = session(3, correlation=correlation)
    noise = session(4, lambda t, x, v, run: 0.0 * x, correlation=correlation).effort
    rows = data.run == 1
    again = data.of_runs(np.array([1]))
    again = replace(again, effort=change(again.effort, noise[: np.sum(rows)]))
    both = joined(data, again)
    assert "run 6 is a copy of run 1: " in quality_warnings(both)[0]
    assert set(both.run[~usable(both)]) == {6}


@pytest.mark.parametrize(("correlation", "corner_n"), [(0.0, 0.0), (0.0, 20.0), (0.6, 20.0)])
def test_repeated_motion_is_no_copy(correlation, corner_n):
    """The very same positions, to the last digit, with other noise and a jump of the force."""
    first, second = (session(3, correlation=correlation), session(4, correlation=correlation))
    rows = first.run == 0
    own = kelvin_voigt(first.position, first.velocity)
    noise = second.effort - kelvin_voigt(second.position, second.velocity)
    effort = own[rows] + noise[: np.sum(rows)]
    both = joined(first, replace(first.of_runs(np.array([0])), effort=effort))
    turned = both.position > 0.5 * both.position.max()
    both = replace(both, effort=both.effort + corner_n * turned)
    assert usable(both).all()
    assert quality_warnings(both) == []


def test_repeated_jitter_of_the_clock_is_no_copy():
    """Uneven times that repeat bend the readings of a steady ramp alike in each run, more than the noise."""
    jitter_s = np.tile([0.0, 4e-4, -4e-4, 0.0, 3e-4, -3e-4], 100)
    t, rng = np.arange(600) / RATE_HZ + jitter_s, np.random.default_rng(1)
    x = 0.02 * np.minimum(t, 1.2 - t)
    v = np.where(t < 0.6, 0.02, -0.02)
    time_s, run = np.concatenate([t, t + 2.0]), np.repeat([0, 1], len(t))
    force = kelvin_voigt(np.tile(x, 2), np.tile(v, 2)) + rng.normal(0.0, 2e-4, len(run))
    data = channel(force, time_s, np.tile(x, 2), np.tile(v, 2), run)
    assert usable(data).all()
    copy = replace(data, effort=np.tile(force[: len(t)], 2) + rng.normal(0.0, 2e-5, len(run)))
    assert set(copy.run[~usable(copy)]) == {1}


@pytest.mark.parametrize(("step_n", "correlation"), [(0.0, 0.0), (0.02, 0.0), (0.01, 0.6)])
def test_converter_that_clips_free_air_passes_and_one_that_folds_it_fails(step_n, correlation):
    made = session(3, correlation=correlation)
    force = stepped(made.effort, step_n)
    assert reject_reason(replace(made, effort=np.maximum(force, 0.0))) is None
    if correlation == 0.0:  # else the noise is less than two steps from sample to sample
        rectified = replace(made, effort=np.abs(force))
        assert "rectified" in quality_warnings(rectified)[0]
        left = usable(rectified)
        assert reject_reason(rectified) is None
        assert abs(np.mean(rectified.effort[left] - kelvin_voigt(made.position, made.velocity)[left])) < 2e-3


def test_tare_does_not_hide_folded_readings():
    tare = Tare(DATA.runs, np.full(len(DATA.runs), 0.04), np.full(len(DATA.runs), 0.01))
    assert "rectified" in quality_warnings(replace(DATA, effort=np.abs(F) - 0.04, tare=tare))[0]


def slowly(torque, *, one_way=False):
    """A joint that turns several times, in radians, with a torque that goes slowly with angle or time."""
    data = swinging(10.0)
    t, run = data.time_s, data.run
    if one_way:
        q = (2.0 + 0.2 * run) * t + 0.1 * (1.0 - np.cos(3.0 * t))
        v = 2.0 + 0.2 * run + 0.3 * np.sin(3.0 * t)
        data = replace(data, position=q, velocity=v, acceleration=0.9 * np.cos(3.0 * t))
    noise = np.random.default_rng(1).normal(0, 0.01, len(t))
    effort = 0.002 * data.acceleration + torque(data.position, t) + noise
    return replace(data, time_s=t + 20.0 * run, effort=effort)


def round_and_round(q, v, a):
    return 2.0 * np.sin(30.0 * q) + 0.1 * v + 0.2 * np.sign(v)


TURNS = {
    "a weight in degrees": ("pendulum", lambda: swinging(180.0 / np.pi), True),
    "degrees where no weight is known": ("inertia", lambda: swinging(180.0 / np.pi), True),
    "radians": ("pendulum", swinging, False),
    "radians where no weight is known": ("inertia", swinging, False),
    "a spring wound up": ("inertia", lambda: swinging(30.0, lambda q, v, a: 3.0 * q + 0.1 * v), False),
    "round and round": ("pendulum", lambda: swinging(30.0, round_and_round), False),
    "a cable": ("pendulum", lambda: slowly(lambda q, t: 0.2 * np.sin(q) + 0.05 * q), False),
    "a friction that warms up": (
        "pendulum",
        lambda: slowly(lambda q, t: 0.1 * np.sin(q) + 0.24 * np.exp(-t / 3.0), one_way=True),
        False,
    ),
    "a spiral spring": ("inertia", lambda: slowly(lambda q, t: 0.1 * q + 0.004 * q**2), False),
}


@pytest.mark.parametrize("name", TURNS)
def test_degrees_are_distinguished_from_radians_by_gravity(name):
    base, made, is_told = TURNS[name]
    data = made()
    assert reject_reason(data) is None
    assert ["if the angle is in degrees" in words for words in quality_warnings(data, model(base))] == (
        [True] if is_told else []
    )


def test_glitches_are_excluded_and_steps_are_preserved():
    effort = F.copy()
    effort[[300, 900]] = -200.0
    good = usable(replace(DATA, effort=effort))
    assert not good[[300, 900]].any()
    assert good.mean() > 0.99
    assert usable(replace(DATA, effort=np.where(COUNT > 1000, 5.0, 0.0) + F)).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data, None),
        (lambda data: replace(data, effort=np.zeros(len(data))), None),  # no contact at all is said elsewhere
        (
            lambda data: session(3, lambda t, x, v, run: kelvin_voigt(x - 0.005, v)),
            "the force stays at its free-air level down to a displacement of 5.",
        ),
        (
            lambda data: session(3, lambda t, x, v, run: kelvin_voigt(x - 0.005 * (run > 0), v), runs=12),
            "after the first contact, the force stays at its free-air level down to a displacement of 4.",
        ),
        (lambda data: replace(data, effort=40.0 * np.maximum(data.position, 0.0) ** 1.5), None),  # a ball
    ],
    ids=["from its zero on", "nothing", "over 5 mm of air", "not recovered", "Hertz"],
)
def test_force_that_starts_below_the_surface_is_reported(change, says):
    found = late_touch(change(DATA))
    assert found is None if says is None else found.startswith(says)


@pytest.mark.parametrize("step", [0.0, 3e-4])
def test_resting_joint_with_position_noise_is_not_judged(step):
    rng, count = np.random.default_rng(2), 3000
    noise, t = 1e-4 * rng.standard_normal(count), 0.01 * np.arange(count)
    noise = step * np.round(2.0 * noise / step) if step else noise
    torque = 1.0 + 0.02 * rng.standard_normal(count)

    def joint(position, effort):
        velocity = np.gradient(position, t)
        motion = (position, velocity, np.gradient(velocity, t))
        run, phase = np.arange(count) // 1000, np.full(count, -1)
        return ChannelData("joint_1", ChannelKind.REVOLUTE, t, *motion, effort, run, phase)

    assert "the position varies at random by" in reject_reason(joint(noise, torque))
    assert at_rest(joint(noise, torque + 5e3 * noise)) is None  # such as postures in any order
    if not step:  # poses in random order, which the effort does not follow
        assert "the position varies at random by" in reject_reason(joint(150.0 * noise, torque))
        assert at_rest(joint(250.0 * noise, torque)) is None
        turned = joint(250.0 * noise, torque)
        assert at_rest(replace(turned, kind=ChannelKind.PRISMATIC)) is not None
    assert at_rest(joint(noise + 3e-4 * np.sin(0.3 * t), torque)) is None


@pytest.mark.parametrize(("noise_n", "is_contact"), [(0.01, True), (10.0, False)])
def test_smooth_force_outside_the_object_is_not_noise(noise_n, is_contact):
    """A damper pulls on both sides of the assumed surface, as strongly as while pressed."""
    noise = noise_n * np.random.default_rng(0).standard_normal(len(DATA))
    swing = 1e-3 * np.sin(10.0 * DATA.time_s)
    speed = 1e-2 * np.cos(10.0 * DATA.time_s)
    data = replace(DATA, position=swing, velocity=speed, effort=100.0 * speed + noise)
    assert ("no contact: the force" in (reject_reason(data) or "")) is not is_contact


def test_effort_that_may_be_a_size_without_its_sign_causes_a_warning():
    data = swinging(torque=lambda q, v, a: 0.6 * np.tanh(20.0 * v))
    coarse = replace(data, effort=0.5 * np.floor(np.abs(data.effort) / 0.5))
    said = "no reading is below zero, although the joint moves both ways"
    assert any(said in warning for warning in quality_warnings(coarse))
    for sound in (data, replace(data, effort=coarse.effort + 0.5)):  # a load may act on one side
        assert not any(said in warning for warning in quality_warnings(sound))
