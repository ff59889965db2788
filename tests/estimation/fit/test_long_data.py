"""Long recordings: block averages, thinning, and what is reported."""

from functools import cache

import numpy as np
import pytest

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.effects.elastic_shape import CubicStiffness, Stiffness
from palpate.estimation.effects.rate_dependence import Damping
from palpate.estimation.fit import long_data
from palpate.estimation.fit.long_data import _within_blocks, shortened
from palpate.estimation.model import Model
from palpate.estimation.study import ModelStudy
from palpate.estimation.study.fitting import fit_base
from palpate.estimation.study.source import DataSource, limit_length
from palpate.robot_io.errors import InputError

RATE_HZ, RUN_S, RUNS, NOISE_N = 1000.0, 20.0, 8, 0.02
TRUTH = {"stiffness.k": 800.0, "damping.c": 6.0, "cubic_stiffness.k3": 5e6}


@pytest.fixture(autouse=True)
def _soon_long(monkeypatch):
    """What is long after two minutes here takes an hour elsewhere."""
    for name, samples in {"LONG": 50_000, "_MAX_BLOCKS": 2_000, "_MAX_SAMPLES": 10**6}.items():
        monkeypatch.setattr(long_data, name, samples)


def channel(position, effort, run, kind=ChannelKind.CONTACT):
    time_s = np.arange(len(position)) / RATE_HZ
    motion = differentiate(time_s, position, run)
    phase = np.full(len(run), -1)
    return ChannelData(
        "contact", kind, time_s, position, motion.velocity, motion.acceleration, effort, run, phase
    )


@cache
def presses(quick_hz=0.4):
    """Slow presses of a hardening object, each with a swing riding on it."""
    rng, count = np.random.default_rng(1), int(RUN_S * RATE_HZ)
    share, motions, speeds = np.arange(count) / count, [], []
    for run in range(RUNS):
        depth, turn = 0.005 + 0.0006 * run, 2.0 * np.pi
        wave = turn * quick_hz * RUN_S
        motions.append(0.5 * depth * (1 - np.cos(turn * share)) - 0.001 + 3e-4 * np.sin(wave * share))
        rate = 0.5 * depth * turn * np.sin(turn * share) + 3e-4 * wave * np.cos(wave * share)
        speeds.append(rate / RUN_S)
    x, v = np.concatenate(motions), np.concatenate(speeds)
    force = np.where(
        x > 0, TRUTH["stiffness.k"] * x + TRUTH["damping.c"] * v + TRUTH["cubic_stiffness.k3"] * x**3, 0
    )
    effort = force.clip(0) + rng.normal(0, NOISE_N, len(x))
    return channel(x + rng.normal(0, 1e-6, len(x)), effort, np.repeat(np.arange(RUNS), count))


@pytest.fixture
def recording():
    return presses()


def test_short_recording_is_unchanged_and_blocks_are_averaged(recording):
    short = recording.select(np.arange(8_000))
    assert shortened(short) == (short, "", {})
    two = recording.of_runs(np.array([0, 1]))
    assert len(two) < long_data.LONG
    short, said, run_of = shortened(two)
    assert short.averaged >= 20
    assert len(long_data._means(two, 2)) == len(two) // 2
    assert "No information is lost" in said
    assert not run_of


def test_parameters_equal_those_of_the_full_recording(recording):
    short, said, _ = shortened(recording)
    assert short.averaged >= 40
    assert len(short) == len(recording) // short.averaged
    assert (
        f"averaged in blocks of {short.averaged} to {len(short):,} at {RATE_HZ / short.averaged:.4g} Hz"
        in said
    )
    model = Model("hardening", (Stiffness(), Damping(), CubicStiffness()))
    full, coarse = (fit_base(one, model).parameters for one in (recording, short))
    for name, value in TRUTH.items():
        assert abs(coarse[name].value - value) < 4.0 * coarse[name].std_err, name
        assert abs(coarse[name].value - full[name].value) < 3.0 * full[name].std_err, name
        assert coarse[name].std_err < 1.3 * full[name].std_err, name


@pytest.mark.parametrize(
    ("quick_hz", "least_hz", "most_hz"), [(0.4, 5, 26), (5.0, 50, 110), (20.0, 190, 210)]
)
def test_faster_motion_needs_a_higher_rate(quick_hz, least_hz, most_hz):
    short, *_ = shortened(presses(quick_hz))
    assert least_hz <= RATE_HZ / short.averaged <= most_hz


def test_tone_above_the_new_rate_is_no_noise(recording):
    tone = 0.5 * NOISE_N * np.sin(2 * np.pi * 50.0 * recording.time_s)
    quiet = _within_blocks(recording, 40)
    loud = _within_blocks(channel(recording.position, recording.effort + tone, recording.run), 40)
    assert quiet.is_noise(40)
    assert not loud.is_noise(40)
    assert loud.departure == pytest.approx(np.hypot(NOISE_N, 0.5 * NOISE_N / np.sqrt(2)), rel=0.02)
    assert quiet.noise == pytest.approx(NOISE_N, rel=0.02)


def test_evenly_spaced_runs_are_selected(recording, monkeypatch):
    long = channel(
        np.tile(recording.position, 2), np.tile(recording.effort, 2), np.repeat(np.arange(16), 20_000)
    )
    whole, *_ = shortened(long)
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", len(whole) // 2)
    some, said, _ = shortened(long)
    assert some.runs.tolist() == list(range(0, 16, 2))
    assert "8 of the 16 runs are used, evenly spread, so intervals are 1.4 times as wide" in said


@pytest.mark.parametrize(("swing_hz", "runs"), [(0.7, 20), (0.002, 1)])
def test_single_run_of_a_joint_is_thinned_by_stretches_covering_its_motion(swing_hz, runs, monkeypatch):
    time_s, rng = np.arange(200_000) / RATE_HZ, np.random.default_rng(1)
    angle = np.sin(2 * np.pi * swing_hz * time_s)
    effort = 2.0 * angle + rng.normal(0, 0.01, len(angle))
    one = channel(angle, effort, np.zeros(len(angle), np.int64), ChannelKind.REVOLUTE)
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", len(shortened(one)[0]) // 2 + 1)
    assert len(shortened(one)[0].runs) == runs


@cache
def quick(runs, kind=ChannelKind.REVOLUTE):
    """A motion whose effort changes too quickly for means over more than two samples."""
    time_s = np.arange(200_000) / RATE_HZ
    rng, swing = np.random.default_rng(3), np.sin(2 * np.pi * 0.7 * time_s)
    effort = 2.0 * swing + np.sin(2 * np.pi * 230.0 * time_s) + rng.normal(0, 0.01, len(time_s))
    return channel(swing, effort, np.arange(len(time_s)) * runs // len(time_s), kind)


@pytest.mark.parametrize(
    ("kind", "runs", "words"),
    [
        (ChannelKind.REVOLUTE, 1, "stretches are used, evenly spread"),
        (ChannelKind.REVOLUTE, 7, "stretches are used, evenly spread"),
        (ChannelKind.REVOLUTE, 300, "of the 300 runs are used"),
        (ChannelKind.CONTACT, 1, "which loses faster changes"),
        (ChannelKind.CONTACT, 7, "which loses faster changes"),
    ],
)
def test_long_recording_is_shortened_and_the_method_reported(kind, runs, words, monkeypatch):
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", 3_000)
    whole = quick(runs, kind)
    short, said, _ = shortened(whole)
    assert len(short) <= 2 * 3_000
    assert words in said
    assert len(short.runs) >= min(runs, 6)
    assert np.ptp(short.position) > 0.8 * np.ptp(whole.position)


@pytest.mark.parametrize(("runs", "most"), [(1, 10**6), (2, 10**6), (2, 3_000)])
def test_motions_of_a_mostly_resting_joint_are_selected(runs, most, monkeypatch):
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", most)
    one = quick(runs)
    time_s = one.time_s
    moves = (time_s % 33.0 > 5.0) & (time_s % 33.0 < 12.0)  # six times, the fewest that suffice
    noise = np.random.default_rng(1).normal(0.0, 2e-5, len(time_s))
    rests = channel(one.position * moves + noise, one.effort * moves, one.run, ChannelKind.REVOLUTE)
    short, said, run_of = shortened(rests)
    assert "in 6 motions from rest to rest" in said
    assert np.mean(np.abs(short.position) > 0.0) > 0.8
    assert {*run_of.values()} == {*range(runs)}
    for run in short.runs:
        of_run = short.time_s[short.run == run]
        begin_s, end_s = one.time_s[one.run == run_of[int(run)]][[0, -1]]
        assert begin_s <= of_run[0] < of_run[-1] <= end_s
        if most > 10**4:
            assert of_run[0] % 33.0 == pytest.approx(4.5, abs=0.1)
            assert of_run[-1] % 33.0 == pytest.approx(12.5, abs=0.1)


def test_rest_is_kept_if_too_few_samples_would_remain():
    time_s = np.arange(200_000) / RATE_HZ
    once = np.clip(time_s - 20.0, 0.0, 10.0)
    rests = channel(once, 2.0 * once, np.zeros(len(once), np.int64), ChannelKind.REVOLUTE)
    short, said, run_of = shortened(rests)
    assert "rest to rest" not in said
    assert run_of == {}
    assert np.ptp(short.time_s) > 199.0


def test_study_reports_averaging(recording):
    source = limit_length(DataSource("presses.csv", (recording,), notes=("first",)))
    first, said = source.notes
    assert first == "first"
    assert source.averaged == {"contact": said}
    assert source.channels[0].averaged > 1


@pytest.mark.parametrize("runs", [3, 40])
def test_held_out_runs_are_recorded_runs(runs, monkeypatch):
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", 5_000)
    whole = quick(runs)
    source = DataSource("swings.csv", (whole,))
    study = ModelStudy(source, held_out=(1,))
    one = study.channel()
    begin_s, end_s = whole.time_s[whole.run == 1][[0, -1]]
    inside = (begin_s <= one.measured.time_s) & (one.measured.time_s <= end_s)
    assert np.array_equal(one.measured.run == 1, inside)
    assert np.sum(inside) == np.sum(whole.run == 1) // one.measured.averaged
    assert len(one.to_fit) <= 2 * 5_000
    assert len(one.to_fit.runs) >= 6
    assert set(one.measured.run[study.fit(one).scored]) == {1}
    (found,) = study.estimate("lsq", runs=[0])
    assert found.channel.time_s.max() < begin_s
    with pytest.raises(InputError, match="no run 77"):
        ModelStudy(source, held_out=(77,))


def test_recorded_runs_of_a_cut_recording_can_be_excluded(monkeypatch):
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", 5_000)
    whole = quick(3)
    source = ModelStudy(DataSource("swings.csv", (whole,))).source
    assert source.runs == (0, 1, 2)
    assert source.without([2]).channels[0].time_s.max() < whole.time_s[whole.run == 2][0]
    held = ModelStudy(source, held_out=[2]).channel()
    assert held.to_fit.time_s.max() < whole.time_s[whole.run == 2][0] < held.data.time_s.max()


@pytest.mark.parametrize("cut", [True, False])
def test_stretches_of_one_recording_share_their_zero(cut, monkeypatch):
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", 5_000 if cut else 10**6)
    tried = []

    def judge(data, models, effects, progress, file):
        tried.extend(effect.name for effect in effects)
        raise InputError("seen")

    whole = quick(3)
    with pytest.raises(InputError, match="seen"):
        ModelStudy(DataSource("swings.csv", (whole,))).diagnose(judge=judge)
    assert "coulomb_friction" in tried
    assert ("run_offset" in tried) is not cut


@pytest.mark.parametrize(("most", "chosen"), [(4_000, 20), (2_000, 10)])
def test_stretches_without_motion_are_dropped_before_others(most, chosen, monkeypatch):
    monkeypatch.setattr(long_data, "_MAX_SAMPLES", most)
    time_s = np.arange(8000) / RATE_HZ
    position = np.where(time_s < 4.0, np.sin(2.0 * np.pi * 5.0 * time_s), 0.0)  # 20 of 40 stretches
    joint = channel(position, position, np.zeros(8000, dtype=int), ChannelKind.REVOLUTE)
    short, words, run_of = long_data._fewer_stretches(joint, np.empty(0, dtype=int))
    assert len(short.runs) == chosen
    assert short.time_s.max() < 4.0
    assert f"{chosen} of the 20 stretches that cover at least 30 % of the motion (40 in all)" in words
    assert {*run_of.values()} == {0}
