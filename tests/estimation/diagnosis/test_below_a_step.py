"""What is less than a step of the reader, where an effort crosses few, is neither named nor ruled out."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from estimation.diagnosis.judgement.below_a_step import below_a_step

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.fit.standing import stand
from estimation.model import Model

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("PALPATE_DATA") or ROOT.parent / "shared" / "data")
STEP = 0.25
MODEL = Model("elastic", (EFFECTS["stiffness"](), EFFECTS["bias"]()))


def held_joint(sag=0.0, noise=0.5, step=STEP, stiffness=0.0):
    """A joint that is pulled to and fro at 10 Hz, and sags and comes back as time goes on [steps]."""
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(6), 47)
    time_s = np.arange(len(run)) * 0.1
    x = np.sin(2 * np.pi * time_s / 4.0)
    v, a = (np.gradient(s, 0.1) for s in (x, np.gradient(x, 0.1)))
    felt = STEP * (stiffness * x + sag * np.cos(2 * np.pi * time_s / 28.2) + rng.normal(0.0, noise, len(x)))
    reading = np.round(felt / step) * step if step else felt
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, x, v, a, reading, run, np.full(len(x), -1))


def verdict(data, *known):
    effects = [EFFECTS[name]() for name in known]
    return diagnose(data, MODEL, effects, rng=np.random.default_rng(0)).channels[0]


def test_what_is_left_below_a_step_of_the_reader_is_not_called_unexplained():
    found = verdict(held_joint(sag=0.8), "quantisation")
    assert found.verdict is Verdict.INSUFFICIENT
    assert "5 different readings, 0.25 N m apart" in found.reason
    assert "finer" in found.reason
    assert "takes more effort" in found.next_experiment.instruction


def test_a_finer_reader_would_show_it():
    found = verdict(held_joint(sag=0.8, step=None), "quantisation")
    assert found.verdict is Verdict.UNEXPLAINED
    assert "time" in found.depends_on


def test_where_nothing_knows_steps_they_are_left_unexplained():
    """The steps themselves can be seen, and nothing that was tried is like them."""
    data = held_joint(noise=0.05, stiffness=3.0)
    assert verdict(data, "backlash").verdict is Verdict.UNEXPLAINED
    assert [entry.effect for entry in verdict(data, "hysteresis", "quantisation").accepted] == [
        "quantisation"
    ]


@pytest.mark.parametrize(
    ("made", "told"),
    [
        ({"sag": 0.8}, True),
        ({"sag": 3.0}, False),  # the model is off by more than a step
        ({"noise": 3.0}, False),
        ({"stiffness": 12.0}, False),  # many steps are crossed
        ({"step": None}, False),
    ],
)
def test_only_an_error_below_a_step_and_few_readings_are_too_coarse(made, told):
    standing = stand(held_joint(**made), MODEL, {})
    assert (below_a_step(standing) is not None) == told


@pytest.mark.skipif(
    not (DATA / "servo_backlash").is_dir(),
    reason=f"the measured data are not at {DATA} (set PALPATE_DATA to where they are)",
)
def test_a_measured_servo_without_play_has_nothing_missing_that_its_encoder_shows(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
    from measured import read

    found = verdict(
        read.servo(DATA / "servo_backlash", "motor_telemetry_comp2", 1), "quantisation", "backlash"
    )
    assert found.verdict is Verdict.INSUFFICIENT
    assert "5 different readings" in found.reason
