"""Error patterns of a comparison: where the error is, and which kinds explain it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from palpate.estimation.diagnosis.completeness import Completeness
from palpate.estimation.fit.measurement_noise import MeasurementNoise, NoiseSource
from palpate.estimation.kinds import Kind
from palpate.estimation.study import ErrorPart, ModelStudy
from palpate.estimation.study.comparison import _words, patterns
from tests.estimation import swings as pendulum
from tests.palpate.presses import press_rows

SPEEDS = (0.02, 0.04, 0.08, 0.03)


def part(label, mean, rmse=None, samples=100):
    size = abs(mean) if rmse is None else rmse
    return ErrorPart(label, samples, size, mean, 0.0, size)


def presses(law):
    rng = np.random.default_rng(3)
    rows = np.vstack([press_rows(run, speed, law, rng) for run, speed in enumerate(SPEEDS)])
    names = ("time_s", "displacement_m", "force_N", "run")
    return dict(zip(names, rows.T, strict=True))


def swings(extra):
    run, t = np.repeat(np.arange(3), 1000), np.tile(np.arange(1000) * 0.005, 3)
    w = 3.0 + 0.7 * run
    q, v, a = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
    noise = np.random.default_rng(0).normal(0, 0.01, len(t))
    torque = 0.2 * a + 2.0 * np.sin(q) + extra(q, v) + noise
    return {"time_s": t, "run": run, "position_rad": q, "torque_Nm": torque}


def test_means_are_compared_where_all_errors_have_the_same_size():
    noise = MeasurementNoise(0.1, NoiseSource.NEIGHBORS, None, 0.0)
    moving = part("moving in", 0.4, 0.50), part("moving out", -0.4, 0.51)
    for by, parts, words in (
        ("direction", moving, "measured minus modeled is +0.4 N (moving in) and -0.4 N (moving out)."),
        ("depth", (part("shallow", 0.1, 0.2), part("deep", 0.4, 0.6)), "By depth, the largest error is 0.6"),
    ):
        _, sentence = _words(0.5, noise, {by: parts}, "N")
        assert sentence.startswith("The error has the same size at any direction") == (by == "direction")
        assert words in sentence


RUBBING = presses(lambda x, v: 400 * x + 6 * v + 0.3 * np.tanh(v / 0.0005))


@pytest.mark.parametrize(
    ("data", "model", "by", "kind"),
    [
        (presses(lambda x, v: 400 * x + 6 * v + 2e6 * x**3), "kelvin_voigt", "depth", Kind.ELASTIC_SHAPE),
        (RUBBING, "kelvin_voigt", "direction", Kind.FRICTION),
        (
            presses(lambda x, v: 400 * x + 6 * v + 200 * v * np.abs(v)),
            *("kelvin_voigt", "speed", Kind.RATE_DEPENDENCE),
        ),
        (swings(lambda q, v: 0.3 * np.tanh(v / 0.01)), "pendulum", "direction", Kind.FRICTION),
        (swings(lambda q, v: 0.3 + 0 * q), "pendulum", "all", Kind.SENSOR_STATICS),
    ],
)
def test_omitted_kind_comes_first(data, model, by, kind):
    compared = ModelStudy(data, model).compare().channels[0]
    if data is RUBBING:  # what rubs pushes back on the way in and holds back on the way out
        means = {part.label: part.mean for part in compared.parts["direction"]}
        assert means["moving in"] > 0.05
        assert means["moving out"] < -0.05
    assert by in [pattern.by for pattern in compared.patterns]
    assert compared.kinds[0].kind is kind
    assert compared.kinds[0].share > sum(entry.share for entry in compared.kinds[1:])
    assert f": {kind.word} " in compared.words[-1]


def test_equally_explanatory_kinds_are_named():
    """A force that hardly grows with the speed passes for friction."""
    data = presses(lambda x, v: 500 * x + 5 * v + 0.8 * np.abs(v) ** 0.3 * np.sign(v))
    compared = ModelStudy(data, "kelvin_voigt").compare().channels[0]
    entry = compared.kinds[0]
    assert {entry.kind, *entry.replaceable_by} == {Kind.RATE_DEPENDENCE, Kind.FRICTION}
    assert f"% (or {entry.replaceable_by[0].word})" in compared.words[-1]
    # 2 N throughout at low speed and none at high speed: about the mean of 1 N, both are 1 N.
    parts = {"speed": (part("slow", 2.0), part("fast", 0.0))}
    assert "speed" not in [pattern.by for pattern in patterns(parts, np.sqrt(2.0))]


@pytest.mark.parametrize(
    "data", [presses(lambda x, v: 400 * x + 6 * v), swings(lambda q, v: 0.2 * v)], ids=["press", "swing"]
)
def test_noise_suggests_nothing(data):
    model = "kelvin_voigt" if "force_N" in data else "pendulum"
    compared = ModelStudy(data, model).compare().channels[0]
    assert compared.patterns == ()
    assert compared.kinds == ()


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"direction": (part("moving in", 1.0), part("moving out", -1.0))}, "changes with"),
        ({"direction": (part("moving in", 0.1, 1.0), part("moving out", -0.1, 1.0))}, None),
        ({"run": (part("run 0", 1.0), part("run 1", -1.0))}, "differs from run to run"),
        ({"speed": (part("slow", 0.0, 2.0), part("fast", 0.0, 0.5))}, "is largest at low speed"),
        ({"speed": (part("slow", 0.0, 0.5), part("fast", 0.0, 2.0))}, "is largest at high speed"),
        ({"temperature": (part("20", 1.0), part("30", -1.0))}, "varies with temperature"),
        ({"depth": (part("a", 1.0), part("b", -1.0)), "effort": (part("a", 1.0), part("b", -1.0))}, "depth"),
        (
            {
                "direction": (part("moving in", 1.0), part("moving out", -1.0)),
                "phase": (part("loading", 1.0), part("unloading", -1.0)),
            },
            "changes with",
        ),
        ({"depth": (part("a", 1.0), part("b", 1.0))}, "has one sign throughout"),
        ({}, None),
    ],
)
def test_pattern_is_the_signal_of_most_error(parts, words):
    found = patterns(parts, 1.0)
    assert [words in one.words for one in found] == ([True] if words else [])


def test_bounded_noise_shows_neither_that_a_model_fits_nor_that_it_does_not():
    """Slow noise may be motion: its bound is as large as the error, of which the model explains nothing."""
    data = pendulum.swings(1)
    slow = lfilter([1.0], [1.0, -0.5], np.random.default_rng(0).normal(size=len(data)))
    compared = ModelStudy(replace(data, effort=slow), "pendulum").compare().channels[0]
    assert compared.noise.is_bound
    assert compared.may_be_noise
    assert compared.words[0].endswith("these data cannot show whether it fits.")


def test_model_below_a_bounded_noise_is_tested(monkeypatch):
    data = pendulum.swings(1)
    slow = lfilter([1.0], [1.0, -0.5], np.random.default_rng(0).normal(size=len(data)))
    study = ModelStudy(replace(data, effort=data.effort + 0.1 * slow), "pendulum")
    told = study.compare().channels[0]
    assert told.noise.is_bound
    assert told.is_complete
    assert not told.may_be_noise
    for test in ("is_complete", "leaves_smoothing"):
        monkeypatch.setattr(Completeness, test, lambda self, fit: False)
    told = ModelStudy(replace(data, effort=data.effort + 0.1 * slow), "pendulum").compare().channels[0]
    assert not told.is_complete
    assert told.words[0].endswith("but a test shows that part of this error is not noise.")
